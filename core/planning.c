/* Arrays of Python to programs of the law and back. */
#include "planning.h"

void hystmpc_clip_plans(int count, int samples, real lower, real upper, real reach, real last, real *plans) {
    for (int n = 0; n < count; n++) hystmpc_clip_plan(samples, lower, upper, reach, last, plans + n * samples);
}

int hystmpc_qp_bytes(int unknowns, int rows, int slacks) {
    return (int)sizeof(real) * hystmpc_qp_reals(unknowns, rows, slacks) + (int)sizeof(int) * (2 * unknowns + slacks);
}

int hystmpc_law_bytes(const void *law) {
    const hystmpc_law *const l = law;
    const int unknowns = hystmpc_program_unknowns(l);
    return hystmpc_qp_bytes(unknowns, hystmpc_program_rows(l), hystmpc_program_slacks(l)) +
           (int)sizeof(real) * hystmpc_program_angles(l) * unknowns;
}

/* An empty program in `room`; answers the `more` numbers behind its own. */
static real *place_any_program(hystmpc_qp *q, int unknowns, int rows, int slacks, int more, char *room) {
    real *const numbers = (real *)(void *)room, *const behind = numbers + hystmpc_qp_reals(unknowns, rows, slacks);
    hystmpc_place_qp(q, unknowns, rows, slacks, numbers, (int *)(void *)(behind + more));
    return behind;
}

void hystmpc_program(const void *law, const void *task, const real *jacobian, const real *commands, const real *angles,
                     char *room, real *hessian, real *gradient, real *rows, real *bounds) {
    const hystmpc_law *const l = law;
    hystmpc_qp q;
    const int unknowns = hystmpc_program_unknowns(l);
    real *const columns = place_any_program(&q, unknowns, hystmpc_program_rows(l), hystmpc_program_slacks(l),
                                            hystmpc_program_angles(l) * unknowns, room);
    if (l->blocked) hystmpc_block_columns(l, jacobian, columns);
    hystmpc_build_program(&q, l, task, commands, angles, l->blocked ? columns : jacobian);
    copy(q.hessian, hessian, q.unknowns * q.unknowns);
    copy(q.gradient, gradient, q.unknowns);
    copy(q.columns, rows, q.unknowns * q.rows);
    copy(q.lower, bounds, q.rows);
    copy(q.upper, bounds + q.rows, q.rows);
    copy(q.soft, bounds + 2 * q.rows, q.rows);
}

void hystmpc_plan_after(const void *law, const void *task, const real *jacobian, const real *commands,
                        const real *angles, const real *primal, char *room, real *out) {
    const hystmpc_law *const l = law;
    real *const foreseen = (real *)(void *)room;
    hystmpc_after_moves(l, task, jacobian, commands, angles, primal, foreseen, out, out + hystmpc_program_commands(l));
}

int hystmpc_quadratic_program(int unknowns, int rows, const real *hessian, const real *gradient,
                              const real *columns, const real *lower, const real *upper, const real *soft,
                              int changes, char *room, real *primal) {
    hystmpc_qp q;
    int slacks = 0;
    for (int r = 0; r < rows; r++) slacks += soft[r] > R(0.0);
    (void)place_any_program(&q, unknowns, rows, slacks, 0, room);
    copy(hessian, q.hessian, unknowns * unknowns);
    copy(gradient, q.gradient, unknowns);
    copy(columns, q.columns, unknowns * rows);
    copy(lower, q.lower, rows);
    copy(upper, q.upper, rows);
    copy(soft, q.soft, rows);
    const int free = hystmpc_solve_free(&q), answer = free < 0 ? free : hystmpc_solve_rows(&q, changes);
    if (answer >= 0) copy(q.primal, primal, unknowns);
    return answer;
}
