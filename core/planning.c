/* Tables of Python to structs of the law and back. */
#include "planning.h"

hystmpc_law hystmpc_law_of(const int *whole, const double *numbers) {
    const int samples = whole[0], moves = whole[1], *starts = whole + 4;
    const double *tracking = numbers + 6, *blocking = tracking + samples;
    const hystmpc_law law = {samples,    moves,    whole[2],       whole[3],   numbers[0], numbers[1],
                             numbers[2], numbers[3], numbers[4], numbers[5], tracking,   starts,
                             starts + moves, blocking, blocking + samples * moves};
    return law;
}

int hystmpc_qp_bytes(int unknowns, int rows, int slacks) {
    return (int)sizeof(double) * hystmpc_qp_reals(unknowns, rows, slacks) +
           (int)sizeof(int) * hystmpc_qp_whole(unknowns, slacks);
}

/* Numbers of the room behind the program, in which samples are fitted too: see sampling.c. */
static int law_reals(const hystmpc_law *l) { return l->horizon * l->moves + (l->moves + 1) * (l->moves + l->horizon); }

int hystmpc_law_bytes(const int *whole) {
    const hystmpc_law l = {.horizon = whole[0], .moves = whole[1], .soft = whole[3]};
    return hystmpc_qp_bytes(l.moves, hystmpc_program_rows(&l), hystmpc_program_slacks(&l)) +
           (int)sizeof(double) * law_reals(&l);
}

static double *place(hystmpc_qp *q, int unknowns, int rows, int slacks, int more, char *work) {
    double *const room = (double *)(void *)work, *const behind = room + hystmpc_qp_reals(unknowns, rows, slacks);
    hystmpc_place_qp(q, unknowns, rows, slacks, room, (int *)(void *)(behind + more));
    return behind;
}

double *hystmpc_place_program(const hystmpc_law *l, char *work, hystmpc_qp *q) {
    return place(q, l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l), law_reals(l), work);
}

void hystmpc_clip_plans(int count, int samples, double lower, double upper, double reach, double last, double *plans) {
    for (int n = 0; n < count; n++) hystmpc_clip_plan(samples, lower, upper, reach, last, plans + n * samples);
}

int hystmpc_cheapest(const int *whole, const double *numbers, int count, const double *plans, const double *angles,
                     const double *reference, const double *feedforward, double u_last, double low, double high,
                     double *costs) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    const hystmpc_task t = {reference, feedforward, u_last, low, high};
    int best = 0;
    for (int n = 0; n < count; n++) {
        costs[n] = hystmpc_plan_cost(&l, &t, plans + n * l.horizon, angles + n * l.horizon);
        if (costs[n] < costs[best]) best = n;
    }
    return best;
}

int hystmpc_fill_candidates(const int *whole, const double *numbers, const double *targets, const double *remaining,
                            int left, double u_last, int resting, double *plans) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    copy(targets + l.horizon, plans + HYSTMPC_INVERTED * l.horizon, l.horizon);
    return hystmpc_candidates(&l, targets, remaining, left, u_last, resting, plans);
}

void hystmpc_program(const int *whole, const double *numbers, const double *columns, const double *reference,
                     const double *feedforward, double u_last, double low, double high, const double *commands,
                     const double *angles, char *work, double *hessian, double *gradient, double *rows,
                     double *bounds) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    const hystmpc_task t = {reference, feedforward, u_last, low, high};
    hystmpc_qp q;
    (void)hystmpc_place_program(&l, work, &q);
    hystmpc_build_program(&q, &l, &t, commands, angles, columns);
    copy(q.hessian, hessian, q.unknowns * q.unknowns);
    copy(q.gradient, gradient, q.unknowns);
    copy(q.columns, rows, q.unknowns * q.rows);
    copy(q.lower, bounds, q.rows);
    copy(q.upper, bounds + q.rows, q.rows);
    copy(q.soft, bounds + 2 * q.rows, q.rows);
}

int hystmpc_quadratic_program(int unknowns, int rows, const double *hessian, const double *gradient,
                              const double *columns, const double *lower, const double *upper, const double *soft,
                              int changes, char *work, double *primal) {
    hystmpc_qp q;
    int slacks = 0;
    for (int r = 0; r < rows; r++) slacks += soft[r] > 0.0;
    (void)place(&q, unknowns, rows, slacks, 0, work);
    copy(hessian, q.hessian, unknowns * unknowns);
    copy(gradient, q.gradient, unknowns);
    copy(columns, q.columns, unknowns * rows);
    copy(lower, q.lower, rows);
    copy(upper, q.upper, rows);
    copy(soft, q.soft, rows);
    const int answer = hystmpc_solve_qp(&q, changes);
    copy(q.primal, primal, unknowns);
    return answer;
}

void hystmpc_blocked_jacobian(const int *whole, const double *numbers, const double *jacobian, double *columns) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    hystmpc_block_columns(&l, jacobian, columns);
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

int hystmpc_plan_step(const int *whole, const double *numbers, const double *jacobian, const double *reference,
                      const double *feedforward, double u_last, double low, double high, const double *commands,
                      const double *angles, int changes, char *work, double *out) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    const hystmpc_task t = {reference, feedforward, u_last, low, high};
    hystmpc_qp q;
    double *const room = hystmpc_place_program(&l, work, &q);
    if (l.blocked) hystmpc_block_columns(&l, jacobian, room);
    hystmpc_build_program(&q, &l, &t, commands, angles, l.blocked ? room : jacobian);
    if (!all_finite(q.gradient, l.moves) || !all_finite(q.hessian, l.moves * l.moves))
        return all_finite(jacobian, l.horizon * l.horizon) ? HYSTMPC_NO_PROGRAM : HYSTMPC_NO_JACOBIAN;
    const int answer = hystmpc_solve_qp(&q, changes);
    if (answer >= 0) step_after(&l, &t, jacobian, commands, angles, q.primal, room, out);
    return answer;
}

void hystmpc_after_moves(const int *whole, const double *numbers, const double *jacobian, const double *reference,
                         const double *feedforward, double u_last, double low, double high, const double *commands,
                         const double *angles, const double *primal, char *work, double *out) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    const hystmpc_task t = {reference, feedforward, u_last, low, high};
    step_after(&l, &t, jacobian, commands, angles, primal, (double *)(void *)work, out);
}

void hystmpc_parts_of_step(const int *whole, const double *numbers, const double *commands, const double *plan,
                           double u_last, double *parts) {
    const hystmpc_law l = hystmpc_law_of(whole, numbers);
    hystmpc_part_plans(&l, commands, plan, u_last, parts);
}
