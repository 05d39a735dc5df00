/* Arrays of Python to structs of the law and back. */
#include "planning.h"

hystmpc_task hystmpc_task_of(const hystmpc_law *l, const void *task) {
    const double *const numbers = task;
    const hystmpc_task t = {numbers + 3, numbers + 3 + l->horizon, numbers[0], numbers[1], numbers[2]};
    return t;
}

int hystmpc_law_size(void) { return (int)sizeof(hystmpc_law); }

void hystmpc_law_init(const int *whole, const double *numbers, char *law) {
    hystmpc_law *const l = (hystmpc_law *)(void *)law;
    l->horizon = whole[0];
    l->moves = whole[1];
    l->blocked = whole[2];
    l->soft = whole[3];
    l->starts = whole + 4;
    l->ends = l->starts + l->moves;
    l->lower = numbers[0];
    l->upper = numbers[1];
    l->reach = numbers[2];
    l->rate_weight = numbers[3];
    l->effort_weight = numbers[4];
    l->soft_weight = numbers[5];
    l->tracking = numbers + 6;
    l->blocking = l->tracking + l->horizon;
    l->constant = l->blocked ? l->blocking + l->horizon * l->moves : l->blocking;
}

int hystmpc_qp_bytes(int unknowns, int rows, int slacks) {
    return (int)sizeof(double) * hystmpc_qp_reals(unknowns, rows, slacks) +
           (int)sizeof(int) * hystmpc_qp_whole(unknowns, slacks);
}

/* Numbers of the room behind the program, in which samples are fitted too: see sampling.c. */
static int law_reals(const hystmpc_law *l) {
    return l->horizon * l->moves + (l->moves + 1) * (l->moves + l->horizon);
}

int hystmpc_law_bytes(const void *law, int more) {
    const hystmpc_law *const l = law;
    const int program = hystmpc_qp_bytes(l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l));
    return program + (int)sizeof(double) * (law_reals(l) + more);
}

static double *place(hystmpc_qp *q, int unknowns, int rows, int slacks, int more, void *room) {
    double *const numbers = room, *const behind = numbers + hystmpc_qp_reals(unknowns, rows, slacks);
    hystmpc_place_qp(q, unknowns, rows, slacks, numbers, (int *)(void *)(behind + more));
    return behind;
}

double *hystmpc_place_program(const hystmpc_law *l, void *room, hystmpc_qp *q) {
    return place(q, l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l), law_reals(l), room);
}

void hystmpc_clip_plans(int count, int samples, double lower, double upper, double reach, double last, double *plans) {
    for (int n = 0; n < count; n++) hystmpc_clip_plan(samples, lower, upper, reach, last, plans + n * samples);
}

void hystmpc_costs(const void *law, const void *task, int count, const double *plans, const double *angles,
                   double *costs) {
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    for (int n = 0; n < count; n++) costs[n] = hystmpc_plan_cost(l, &t, plans + n * l->horizon, angles + n * l->horizon);
}

int hystmpc_cheapest(const void *law, const void *task, int count, const double *plans, const double *angles,
                     double *cost) {
    int best = 0;
    *cost = INFINITE;
    for (int n = 0; n < count; n++) {
        const hystmpc_law *const l = law;
        double one;
        hystmpc_costs(l, task, 1, plans + n * l->horizon, angles + n * l->horizon, &one);
        if (one < *cost) {
            *cost = one;
            best = n;
        }
    }
    return best;
}

int hystmpc_fill_candidates(const void *law, const double *targets, const double *remaining, int left, double u_last,
                            int resting, double *plans) {
    const hystmpc_law *const l = law;
    copy(targets + l->horizon, plans + HYSTMPC_INVERTED * l->horizon, l->horizon);
    return hystmpc_candidates(l, targets, remaining, left, u_last, resting, plans);
}

void hystmpc_blocked_jacobian(const void *law, const double *jacobian, double *columns) {
    hystmpc_block_columns(law, jacobian, columns);
}

void hystmpc_program(const void *law, const void *task, const double *columns, const double *commands,
                     const double *angles, void *room, double *hessian, double *gradient, double *rows,
                     double *bounds) {
    const hystmpc_task t = hystmpc_task_of(law, task);
    hystmpc_qp q;
    (void)hystmpc_place_program(law, room, &q);
    hystmpc_build_program(&q, law, &t, commands, angles, columns);
    copy(q.hessian, hessian, q.unknowns * q.unknowns);
    copy(q.gradient, gradient, q.unknowns);
    copy(q.columns, rows, q.unknowns * q.rows);
    copy(q.lower, bounds, q.rows);
    copy(q.upper, bounds + q.rows, q.rows);
    copy(q.soft, bounds + 2 * q.rows, q.rows);
}

int hystmpc_quadratic_program(int unknowns, int rows, const double *hessian, const double *gradient,
                              const double *columns, const double *lower, const double *upper, const double *soft,
                              int changes, char *room, double *primal) {
    hystmpc_qp q;
    int slacks = 0;
    for (int r = 0; r < rows; r++) slacks += soft[r] > 0.0;
    (void)place(&q, unknowns, rows, slacks, 0, room);
    copy(hessian, q.hessian, unknowns * unknowns);
    copy(gradient, q.gradient, unknowns);
    copy(columns, q.columns, unknowns * rows);
    copy(lower, q.lower, rows);
    copy(upper, q.upper, rows);
    copy(soft, q.soft, rows);
    const int answer = hystmpc_solve_qp(&q, changes);
    if (answer >= 0) copy(q.primal, primal, unknowns);
    return answer;
}

/* In `out` the plan after the moves and its foreseen cost; `foreseen` is room for H angles. */
static void step_after(const hystmpc_law *l, const hystmpc_task *t, const double *jacobian, const double *commands,
                       const double *angles, const double *primal, double *foreseen, double *out) {
    hystmpc_deviation(l, primal, out);
    for (int k = 0; k < l->horizon; k++) out[k] = commands[k] + out[k];
    hystmpc_clip_plan(l->horizon, l->lower, l->upper, l->reach, t->u_last, out);
    hystmpc_foresee(l->horizon, commands, angles, jacobian, out, foreseen);
    out[l->horizon] = hystmpc_plan_cost(l, t, out, foreseen);
}

int hystmpc_plan_step(const void *law, const void *task, const double *jacobian, const double *commands,
                      const double *angles, int changes, void *room, double *out) {
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    hystmpc_qp q;
    double *const behind = hystmpc_place_program(l, room, &q);
    if (l->blocked) hystmpc_block_columns(l, jacobian, behind);
    hystmpc_build_program(&q, l, &t, commands, angles, l->blocked ? behind : jacobian);
    if (!all_finite(q.gradient, l->moves) || !all_finite(q.hessian, l->moves * l->moves))
        return all_finite(jacobian, l->horizon * l->horizon) ? HYSTMPC_NO_PROGRAM : HYSTMPC_NO_JACOBIAN;
    const int answer = hystmpc_solve_qp(&q, changes);
    if (answer >= 0) step_after(l, &t, jacobian, commands, angles, q.primal, behind, out);
    return answer;
}

void hystmpc_after_moves(const void *law, const void *task, const double *jacobian, const double *commands,
                         const double *angles, const double *primal, void *room, double *out) {
    const hystmpc_task t = hystmpc_task_of(law, task);
    step_after(law, &t, jacobian, commands, angles, primal, room, out);
}

void hystmpc_parts_of_step(const void *law, const double *commands, const double *plan, double u_last, double *parts) {
    hystmpc_part_plans(law, commands, plan, u_last, parts);
}
