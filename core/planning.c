/* Arrays of Python to structs of the law and back. */
#include "planning.h"

hystmpc_task hystmpc_task_of(const hystmpc_law *l, const void *task) {
    const real *const numbers = task;
    const hystmpc_task t = {numbers + 3, numbers + 3 + l->horizon, numbers[0], numbers[1], numbers[2]};
    return t;
}

int hystmpc_law_size(void) { return (int)sizeof(hystmpc_law); }

void hystmpc_law_init(const int *whole, const real *numbers, char *law) {
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

static int program_whole(int unknowns, int slacks) { return 2 * unknowns + slacks; }

int hystmpc_qp_bytes(int unknowns, int rows, int slacks) {
    return (int)sizeof(real) * hystmpc_qp_reals(unknowns, rows, slacks) +
           (int)sizeof(int) * program_whole(unknowns, slacks);
}

/* Numbers of the room behind the program, in which samples are fitted too: see sampling.c. */
static int law_reals(const hystmpc_law *l) {
    return l->horizon * l->moves + (l->moves + 1) * (l->moves + l->horizon);
}

static int program_reals(const hystmpc_law *l) {
    return hystmpc_qp_reals(l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l));
}

int hystmpc_law_bytes(const void *law, int more) {
    const hystmpc_law *const l = law;
    return hystmpc_qp_bytes(l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l)) +
           (int)sizeof(real) * (law_reals(l) + more);
}

void hystmpc_step_room(const void *law, int *sizes) {
    const hystmpc_law *const l = law;
    sizes[0] = program_reals(l) + l->horizon * l->moves;
    sizes[1] = program_whole(l->moves, hystmpc_program_slacks(l));
}

static real *place_any_program(hystmpc_qp *q, int unknowns, int rows, int slacks, int more, void *room) {
    real *const numbers = room, *const behind = numbers + hystmpc_qp_reals(unknowns, rows, slacks);
    hystmpc_place_qp(q, unknowns, rows, slacks, numbers, (int *)(void *)(behind + more));
    return behind;
}

real *hystmpc_place_program(const hystmpc_law *l, void *room, hystmpc_qp *q) {
    return place_any_program(q, l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l), law_reals(l), room);
}

void hystmpc_clip_plans(int count, int samples, real lower, real upper, real reach, real last, real *plans) {
    for (int n = 0; n < count; n++) hystmpc_clip_plan(samples, lower, upper, reach, last, plans + n * samples);
}

void hystmpc_costs(const void *law, const void *task, int count, const real *plans, const real *angles,
                   real *costs) {
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    for (int n = 0; n < count; n++) costs[n] = hystmpc_plan_cost(l, &t, plans + n * l->horizon, angles + n * l->horizon);
}

int hystmpc_cheapest(const void *law, const void *task, int count, const real *plans, const real *angles,
                     real *cost) {
    int best = 0;
    *cost = INFINITE;
    for (int n = 0; n < count; n++) {
        const hystmpc_law *const l = law;
        real one;
        hystmpc_costs(l, task, 1, plans + n * l->horizon, angles + n * l->horizon, &one);
        if (one < *cost) {
            *cost = one;
            best = n;
        }
    }
    return best;
}

int hystmpc_fill_candidates(const void *law, const real *targets, const real *remaining, int left, real u_last,
                            int resting, real *plans) {
    const hystmpc_law *const l = law;
    copy(targets + l->horizon, plans + HYSTMPC_INVERTED * l->horizon, l->horizon);
    return hystmpc_candidates(l, targets, remaining, left, u_last, resting, plans);
}

void hystmpc_blocked_jacobian(const void *law, const real *jacobian, real *columns) {
    hystmpc_block_columns(law, jacobian, columns);
}

void hystmpc_program(const void *law, const void *task, const real *columns, const real *commands,
                     const real *angles, void *room, real *hessian, real *gradient, real *rows,
                     real *bounds) {
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
    const int answer = hystmpc_solve_qp(&q, changes);
    if (answer >= 0) copy(q.primal, primal, unknowns);
    return answer;
}

int hystmpc_plan_step(const void *law, const void *task, const real *jacobian, const real *commands,
                      const real *angles, int changes, void *room, real *out) {
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    real *const numbers = room;
    int *const whole = (int *)(void *)(numbers + program_reals(l) + law_reals(l));
    return hystmpc_step_plan(l, &t, jacobian, commands, angles, changes, numbers, whole, out, out + l->horizon);
}

void hystmpc_plan_after(const void *law, const void *task, const real *jacobian, const real *commands,
                        const real *angles, const real *primal, void *room, real *out) {
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    hystmpc_after_moves(l, &t, jacobian, commands, angles, primal, room, out, out + l->horizon);
}

void hystmpc_parts_of_step(const void *law, const real *commands, const real *plan, real u_last, real *parts) {
    hystmpc_part_plans(law, commands, plan, u_last, parts);
}
