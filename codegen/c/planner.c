/* The improvement of a plan: linearise, solve, search along the answer. */
#include "internal.h"

HYSTMPC_LOCAL void clip_plan(real *commands, real last) {
    hystmpc_clip_plan(H, HYSTMPC_LOWER, HYSTMPC_UPPER, HYSTMPC_REACH, last, commands);
}

HYSTMPC_LOCAL real try_plan(const problem *p, const real *commands, const real *angles, plan *found) {
    const real cost = hystmpc_plan_cost(&hystmpc_weighs, &p->task, commands, angles);
    if (cost < found->cost) {
        copy(commands, found->commands, H);
        copy(angles, found->angles, H);
        found->cost = cost;
    }
    return cost;
}

/* The whole step, and where the cost falls by clearly less than the linearisation promised, parts of it too. */
static void search(hystmpc_work *w, const problem *p, const real *whole, real foreseen, plan *best) {
    real(*parts)[HYSTMPC_HORIZON] = w->plans + 2, (*found)[HYSTMPC_HORIZON] = w->angles + 2; /* of spent candidates */
    const plan start = *best;
    state_run(p->state, whole, found[0]);
    const real cost = try_plan(p, whole, found[0], best);
    if (start.cost - cost >= R(0.9) * (start.cost - foreseen)) return;
    hystmpc_part_plans(&hystmpc_weighs, start.commands, whole, p->task.u_last, parts[0]);
    state_run_plans(w, p->state, parts, HYSTMPC_SHARES, found);
    for (int i = 0; i < HYSTMPC_SHARES; i++) (void)try_plan(p, parts[i], found[i], best);
}

/* Sequential-quadratic-programming iterations, guarded by the nonlinear cost; HYSTMPC_OK or why there is none. */
HYSTMPC_LOCAL int improve(hystmpc_work *w, const problem *p, plan *best) {
    real whole[HYSTMPC_HORIZON], foreseen;
    int rounds = HYSTMPC_ITERATIONS;
#if HYSTMPC_LEARNS
    if (p->state->acts && rounds < 2) rounds = 2; /* candidates that follow the model's inverse are far off then */
#endif
    for (int round = 0; round < rounds; round++) {
        state_linearise(w, p->state, best->commands);
        const int answer = hystmpc_step_plan(&hystmpc_weighs, &p->task, w->jacobian[0], best->commands, best->angles,
                                             HYSTMPC_CHANGES, w->program, w->program_whole, whole, &foreseen);
        if (answer < 0) return answer <= HYSTMPC_NO_JACOBIAN ? HYSTMPC_NO_PLAN : HYSTMPC_NO_SOLUTION;
        search(w, p, whole, foreseen, best);
    }
    return HYSTMPC_OK;
}
