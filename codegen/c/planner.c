/* One cost for all plans, and the improvement of one: linearise, solve, search along the answer. */
#include "internal.h"

static const real weights[HYSTMPC_HORIZON] = HYSTMPC_TRACKING;

/* The nearest admissible plan, sample by sample, in place. Commands are rounded to a small share of the greatest move: a
 * play at its edge, or at rest, has another slope on either side, which must not hang on the last digit. */
HYSTMPC_LOCAL void clip_plan(real *commands, real last) {
    const real grain = HYSTMPC_GRAIN * HYSTMPC_REACH, half = R(0.5) * HYSTMPC_GRAIN * HYSTMPC_REACH;
    real before = clamp(last, HYSTMPC_LOWER, HYSTMPC_UPPER);
    for (int k = 0; k < H; k++) {
        if (commands[k] == commands[k]) {
            real u = MATH(rint)(commands[k] / grain) * grain;
            u = u <= HYSTMPC_LOWER + half ? HYSTMPC_LOWER : u >= HYSTMPC_UPPER - half ? HYSTMPC_UPPER : u;
            u = clamp(u, before - HYSTMPC_REACH, before + HYSTMPC_REACH);
            commands[k] = absolute(u - before) <= half && HYSTMPC_LOWER < u && u < HYSTMPC_UPPER ? before : u;
        }
        before = commands[k];
    }
}

/* sum_k q_k (theta_k - r_k)^2 + w_s dist(theta_k, [a, b])^2 + w_r (u_k - u_{k-1})^2 + w_e (u_k - f_k)^2, infinite where
 * it is not finite. */
HYSTMPC_LOCAL real plan_cost(const problem *p, const real *commands, const real *angles) {
    real total = R(0.0), before = p->u_last;
    for (int k = 0; k < H; k++) {
        const real error = angles[k] - p->reference[k], move = commands[k] - before;
        const real off = commands[k] - p->feedforward[k];
        total += weights[k] * error * error + HYSTMPC_RATE_WEIGHT * move * move + HYSTMPC_EFFORT_WEIGHT * off * off;
#if HYSTMPC_SOFT
        const real excess = most(angles[k] - p->high, R(0.0)) + most(p->low - angles[k], R(0.0));
        total += HYSTMPC_SOFT_WEIGHT * excess * excess;
#endif
        before = commands[k];
    }
    return is_finite(total) ? total : INFINITE;
}

/* A plan that is cheaper than `found` takes its place. */
static void try_plan(const problem *p, const real *commands, const real *angles, plan *found) {
    const real cost = plan_cost(p, commands, angles);
    if (!(cost < found->cost)) return;
    copy(commands, found->commands, H);
    copy(angles, found->angles, H);
    found->cost = cost;
}

enum { SHARES = 3 };

/* The whole step, and where the cost falls by clearly less than the linearisation promised, parts of it too. */
static void search(hystmpc_work *w, const problem *p, const real *step, const real *promising, plan *best) {
    static const real shares[SHARES] = {R(0.5), R(0.25), R(0.125)};
    real(*parts)[HYSTMPC_HORIZON] = w->plans + 2, (*found)[HYSTMPC_HORIZON] = w->angles + 2; /* of spent candidates */
    const plan start = *best;
    real commands[HYSTMPC_HORIZON], angles[HYSTMPC_HORIZON];
    for (int k = 0; k < H; k++) {
        commands[k] = start.commands[k] + step[k];
        angles[k] = start.angles[k] + promising[k];
    }
    real whole[HYSTMPC_HORIZON];
    state_run(p->state, commands, whole);
    const real cost = plan_cost(p, commands, whole);
    const real promised = start.cost - plan_cost(p, commands, angles);
    if (cost < best->cost) {
        copy(commands, best->commands, H);
        copy(whole, best->angles, H);
        best->cost = cost;
    }
    if (start.cost - cost >= R(0.9) * promised) return;
    for (int i = 0; i < SHARES; i++) {
        for (int k = 0; k < H; k++) parts[i][k] = start.commands[k] + shares[i] * step[k];
        clip_plan(parts[i], p->u_last);
    }
    state_run_plans(w, p->state, parts, SHARES, found);
    for (int i = 0; i < SHARES; i++) try_plan(p, parts[i], found[i], best);
}

/* Sequential-quadratic-programming iterations, guarded by the nonlinear cost; HYSTMPC_OK or why there is none. */
HYSTMPC_LOCAL int improve(hystmpc_work *w, const problem *p, plan *best) {
    real primal[HYSTMPC_QP_MOVES], step[HYSTMPC_HORIZON], promising[HYSTMPC_HORIZON];
    int rounds = HYSTMPC_ITERATIONS;
#if HYSTMPC_LEARNS
    if (p->state->acts && rounds < 2) rounds = 2; /* candidates that follow the model's inverse are far off then */
#endif
    for (int round = 0; round < rounds; round++) {
        state_linearise(w, p->state, best->commands);
        for (int k = 0; k < H; k++)
            if (!all_finite(w->jacobian[k], k + 1)) return HYSTMPC_NO_PLAN;
        real(*const jacobian)[HYSTMPC_HORIZON] = w->normal; /* building the program may use up the other */
        for (int k = 0; k < H; k++) copy(w->jacobian[k], jacobian[k], H);
        build_program(w, p, best);
        for (int i = 0; i < HYSTMPC_QP_MOVES; i++)
            if (!is_finite(w->gradient[i]) || !all_finite(w->hessian[i], HYSTMPC_QP_MOVES)) return HYSTMPC_NO_PLAN;
        if (!solve_program(w, primal)) return HYSTMPC_NO_SOLUTION;
        deviation(primal, step);
        for (int k = 0; k < H; k++) step[k] += best->commands[k];
        clip_plan(step, p->u_last);
        for (int k = 0; k < H; k++) step[k] -= best->commands[k];
        for (int k = 0; k < H; k++) {
            promising[k] = R(0.0);
            for (int j = 0; j <= k; j++) promising[k] += jacobian[k][j] * step[j];
        }
        search(w, p, step, promising, best);
    }
    return HYSTMPC_OK;
}
