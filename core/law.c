/* One cost for all plans, plans to begin with, and the program that improves one. */
#include "law.h"

/* Rounding of commands as a share of the greatest move; and of a jump, so that rounding does not change by how many
 * samples a plan is postponed. */
#if HYSTMPC_SINGLE
static const real command_grain = R(1e-5), jump_rounding = R(1e-5);
#else
static const real command_grain = R(1e-7), jump_rounding = R(1e-9);
#endif

/* Commands are rounded: a play at its edge, or at rest, has another slope on either side, which must not hang on the last
 * digit. */
HYSTMPC_LOCAL void hystmpc_clip_plan(int samples, real lower, real upper, real reach, real last, real *commands) {
    const real grain = command_grain * reach, half = R(0.5) * command_grain * reach;
    real before = clamp(last, lower, upper);
    for (int k = 0; k < samples; k++) {
        real u = commands[k];
        if (u == u) {
            u = MATH(rint)(u / grain) * grain;
            u = u <= lower + half ? lower : u >= upper - half ? upper : u;
            u = clamp(u, before - reach, before + reach);
            if (absolute(u - before) <= half && lower < u && u < upper) u = before;
        }
        commands[k] = before = u;
    }
}

/* Whether there is an axis with a command, and with an angle, from here on. */
static int law_moves(const hystmpc_law *l) { return l && l->moves; }
static int law_tracks(const hystmpc_law *l) { return l && l->tracking; }

HYSTMPC_LOCAL int hystmpc_program_commands(const hystmpc_law *l) {
    int count = 0;
    for (; law_moves(l); l = l->next) count += l->horizon;
    return count;
}

HYSTMPC_LOCAL int hystmpc_program_angles(const hystmpc_law *l) {
    int count = 0;
    for (; law_tracks(l); l = l->next) count += l->horizon;
    return count;
}

static real asked_move(const hystmpc_task *t, int k) { return t->asked ? t->asked[k] : R(0.0); }

HYSTMPC_LOCAL real hystmpc_plan_cost(const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                                     const real *angles) {
    const int samples = l->horizon;
    real total = R(0.0);
    for (; l; l = l->next, t = t->next, commands += samples, angles += samples) {
        real before = t->u_last;
        for (int k = 0; k < samples; k++) {
            real here = R(0.0);
            if (l->tracking) {
                const real error = angles[k] - t->reference[k];
                here = l->tracking[k] * error * error;
            }
            if (l->moves) {
                const real move = commands[k] - before - asked_move(t, k), off = commands[k] - t->feedforward[k];
                here = here + t->rate_weight * move * move + l->effort_weight * off * off;
                before = commands[k];
            }
            total += here;
            if (l->tracking && l->soft) {
                const real excess = most(angles[k] - t->high, R(0.0)) + most(t->low - angles[k], R(0.0));
                total += l->soft_weight * excess * excess;
            }
        }
    }
    return is_finite(total) ? total : INFINITE;
}

/* Limited in rate backwards in time: every move of the plan starts early enough to arrive. */
static void run_ahead(const hystmpc_law *l, real *commands) {
    for (int k = l->horizon - 2; k >= 0; k--)
        commands[k] = clamp(commands[k], commands[k + 1] - l->reach, commands[k + 1] + l->reach);
}

/* The first jump of the plan later by half of the samples that it takes at the greatest rate. */
static void postpone_half(const hystmpc_law *l, real *commands, real u_last) {
    real before = u_last;
    for (int k = 0; k < l->horizon; k++) {
        const real jump = absolute(commands[k] - before);
        if (jump > l->reach * (R(1.0) + jump_rounding)) {
            const real needed = jump / l->reach - jump_rounding;
            int samples = 0;
            while (samples < 2 * l->horizon && (real)samples < needed) samples++; /* rounded up */
            for (int j = k; j < k + samples / 2 && j < l->horizon; j++) commands[j] = before;
            return;
        }
        before = commands[k];
    }
}

/* Plans that only search: reversals of 2, 4, ... samples at the greatest rate; where the reference rests also steps of a
 * share of a sample at that rate, either way. */
static int search_plans(const hystmpc_law *l, real u_last, int resting, real *plans) {
    static const real shares[8] = {R(0.125), R(0.1875), R(0.25), R(0.375), R(0.5), R(0.625), R(0.75), R(1.0)};
    const int samples = l->horizon, longest = samples / 2 > 2 ? samples / 2 : 2;
    int count = 0;
    for (int sign = 1; sign >= -1; sign -= 2)
        for (int length = 2; length <= longest && samples > 1; length *= 2, count++)
            for (int k = 0; k < samples; k++)
                plans[count * samples + k] =
                    u_last + (real)sign * (l->reach * (real)(k + 1 < length ? k + 1 : length));
    for (int sign = 1; resting && sign >= -1; sign -= 2)
        for (int i = 0; i < 8; i++, count++)
            fill(plans + count * samples, u_last + (real)sign * (l->reach * shares[i]), samples);
    return count;
}

HYSTMPC_LOCAL int hystmpc_candidates(const hystmpc_law *l, const real *boxed, const real *remaining, int left,
                                     real u_last, int resting, real *plans) {
    const int samples = l->horizon;
    real *const row[HYSTMPC_FOLLOWING] = {plans, plans + samples, plans + 2 * samples, plans + 3 * samples,
                                          plans + 4 * samples};
    fill(row[HYSTMPC_HELD], u_last, samples);
    copy(boxed, row[2], samples);
    copy(boxed, row[3], samples);
    for (int k = 0; k < samples; k++)
        row[4][k] = left ? remaining[k < left ? k : left - 1] : row[HYSTMPC_INVERTED][k];
    postpone_half(l, row[3], u_last);
    run_ahead(l, row[2]);
    run_ahead(l, row[3]);
    const int count = HYSTMPC_FOLLOWING + search_plans(l, u_last, resting, plans + HYSTMPC_FOLLOWING * samples);
    for (int n = 0; n < count; n++)
        hystmpc_clip_plan(samples, l->lower, l->upper, l->reach, u_last, plans + n * samples);
    return count;
}

HYSTMPC_LOCAL int hystmpc_program_unknowns(const hystmpc_law *l) {
    int count = 0;
    for (; law_moves(l); l = l->next) count += l->moves;
    return count;
}

/* A row for each command, one for each move, and one for each angle with soft limits. */
HYSTMPC_LOCAL int hystmpc_program_rows(const hystmpc_law *l) {
    return hystmpc_program_commands(l) + hystmpc_program_unknowns(l) + hystmpc_program_slacks(l);
}

HYSTMPC_LOCAL int hystmpc_program_slacks(const hystmpc_law *l) {
    int count = 0;
    for (; law_tracks(l); l = l->next) count += l->soft ? l->horizon : 0;
    return count;
}

HYSTMPC_LOCAL void hystmpc_block_columns(const hystmpc_law *l, const real *jacobian, real *columns) {
    const int samples = l->horizon, rows = hystmpc_program_angles(l);
    for (int row = 0; row < rows; row++)
        for (const hystmpc_law *i = l; law_moves(i); i = i->next, jacobian += samples)
            for (int b = 0; b < i->moves; b++) {
                const int stop = b + 2 < i->moves ? i->starts[b + 2] : samples;
                real sum = R(0.0);
                for (int k = i->starts[b]; k <= row % samples && k < stop; k++)
                    sum += jacobian[k] * i->blocking[k * i->moves + b];
                *columns++ = sum;
            }
}

static real move_of(const hystmpc_task *t, const real *commands, int k) {
    return commands[k] - (k ? commands[k - 1] : t->u_last) - asked_move(t, k);
}

/* The share of a block's move that one of its samples makes; behind the last block nothing moves. */
static real block_share(const hystmpc_law *l, int b) {
    return b < l->moves ? R(1.0) / (real)(l->ends[b] + 1 - l->starts[b]) : R(0.0);
}

/* Of one input, whose unknowns begin at `first`: P = 2 (w_r D'D + w_e I) and q = 2 (w_r D'(D p - e_1 u_last) + w_e (p - f))
 * in the deviations v of its commands from the plan, M'P M and M'q in those at the ends of blocks. */
static void add_moves(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands, int first) {
    const real rate = R(2.0) * t->rate_weight, effort = R(2.0) * l->effort_weight;
    const int m = l->moves;
    for (int b = 0; b < m; b++) {
        real *const hessian = q->hessian + (first + b) * q->unknowns + first, sum = R(0.0);
        if (l->blocked) {
            hessian[b] = rate * (block_share(l, b) + block_share(l, b + 1));
            if (b) hessian[b - 1] = -rate * block_share(l, b);
            for (int k = 0; k < l->horizon; k++) {
                const real here = l->blocking[k * m + b], before = k ? l->blocking[(k - 1) * m + b] : R(0.0);
                hessian[b] += effort * here * here;
                if (b) hessian[b - 1] += effort * here * l->blocking[k * m + b - 1];
                sum += rate * (here - before) * move_of(t, commands, k);
                sum += effort * here * (commands[k] - t->feedforward[k]);
            }
        } else {
            hessian[b] = effort + (b + 1 < m ? R(2.0) * rate : rate);
            if (b) hessian[b - 1] = -rate;
            sum = effort * (commands[b] - t->feedforward[b]) + rate * move_of(t, commands, b);
            if (b + 1 < m) sum -= rate * move_of(t, commands, b + 1);
        }
        q->gradient[first + b] = sum;
    }
}

/* Of all angles, with C = J M: P += 2 C'QC, q += 2 C'Q (theta_p - r). An unknown acts from its first sample on. */
static void add_tracking(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *angles,
                         const real *columns) {
    const int samples = l->horizon, n = q->unknowns;
    real *const weighted = q->at; /* (H) */
    int u = 0;
    for (const hystmpc_law *i = l; law_moves(i); i = i->next)
        for (int b = 0; b < i->moves; b++, u++) {
            const int first = i->starts[b];
            const real *angle = angles, *slopes = columns;
            const hystmpc_task *aim = t;
            real total = q->gradient[u];
            for (const hystmpc_law *o = l; law_tracks(o); o = o->next, aim = aim->next, angle += samples, slopes += samples * n) {
                for (int k = first; k < samples; k++) {
                    weighted[k] = R(2.0) * o->tracking[k] * slopes[k * n + u];
                    total += weighted[k] * (angle[k] - aim->reference[k]);
                }
                add_rows(q->hessian + u * n, u + 1, weighted + first, 1, slopes + first * n, n, samples - first);
            }
            q->gradient[u] = total;
        }
}

/* Bounds of the move of block b: that of v is one number in a block, so is its rate limit, and the plan's greatest move in
 * the block decides. The plan is admissible but for rounding, so that no move always is. */
static void bounds_of_move(const hystmpc_law *l, const hystmpc_task *t, const real *commands, int b, real *low,
                           real *high) {
    real slowest = move_of(t, commands, l->starts[b]), fastest = slowest;
    for (int k = l->starts[b] + 1; k <= l->ends[b]; k++) {
        slowest = least(slowest, move_of(t, commands, k));
        fastest = most(fastest, move_of(t, commands, k));
    }
    const real length = (real)(l->ends[b] + 1 - l->starts[b]);
    *low = length * least(-l->reach - slowest, R(0.0));
    *high = length * most(l->reach - fastest, R(0.0));
}

static int bound_move(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands, int b,
                      real *columns, int row) {
    columns[b * q->rows + row] = R(1.0);
    if (b) columns[(b - 1) * q->rows + row] = R(-1.0);
    bounds_of_move(l, t, commands, b, q->lower + row, q->upper + row);
    return row + 1;
}

/* The command of sample k, which lies in block b or behind it, within the box. `columns`: of the input's unknowns. */
static int bound_command(hystmpc_qp *q, const hystmpc_law *l, const real *commands, int k, int b, real *columns, int row) {
    for (int i = l->blocked && b ? b - 1 : b; i <= b; i++)
        columns[i * q->rows + row] = l->blocked ? l->blocking[k * l->moves + i] : R(1.0);
    q->lower[row] = l->lower - commands[k];
    q->upper[row] = l->upper - commands[k];
    return row + 1;
}

/* Soft limits of an angle in sample k, which depends on all unknowns that act by then: a variable s of its own, with
 * a <= theta_p + J v + s <= b at the cost w_s s^2. `limited`: law of the axis. Answers the row behind. */
static int soften(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_law *limited, const hystmpc_task *t, real angle,
                  const real *slopes, int k, int row) {
    int u = 0;
    for (; law_moves(l); u += l->moves, l = l->next)
        for (int b = 0; b < l->moves && l->starts[b] <= k; b++) q->columns[(u + b) * q->rows + row] = slopes[u + b];
    q->soft[row] = R(0.5) / limited->soft_weight;
    q->lower[row] = t->low - angle;
    q->upper[row] = t->high - angle;
    return row + 1;
}

static void build_cost(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                       const real *angles, const real *columns) {
    const hystmpc_task *task = t;
    int first = 0;
    for (const hystmpc_law *i = l; law_moves(i); first += i->moves, i = i->next, task = task->next, commands += l->horizon)
        add_moves(q, i, task, commands, first);
    add_tracking(q, l, t, angles, columns);
}

static void build_rows(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                       const real *angles, const real *columns) {
    const int samples = l->horizon, n = q->unknowns;
    int first = 0, row = 0;
    fill(q->columns, R(0.0), n * q->rows);
    fill(q->soft, R(0.0), q->rows);
    for (const hystmpc_law *axis = l; axis; first += axis->moves, axis = axis->next, t = t->next) {
        real *const moved = q->columns + first * q->rows;
        for (int k = 0, b = 0; k < samples; k++) { /* b: the block of sample k, the last one behind all blocks */
            if (b + 1 < axis->moves && k == axis->starts[b + 1]) b++;
            if (axis->moves && k == axis->starts[b]) row = bound_move(q, axis, t, commands, b, moved, row);
            if (axis->moves) row = bound_command(q, axis, commands, k, b, moved, row);
            if (axis->tracking && axis->soft) row = soften(q, l, axis, t, angles[k], columns + k * n, k, row);
        }
        commands += samples, angles += samples, columns += samples * n;
    }
}

HYSTMPC_LOCAL void hystmpc_build_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                         const real *commands, const real *angles, const real *columns) {
    build_cost(q, l, t, commands, angles, columns);
    build_rows(q, l, t, commands, angles, columns);
}

HYSTMPC_LOCAL void hystmpc_deviation(const hystmpc_law *l, const real *primal, real *deviation) {
    for (; law_moves(l); deviation += l->horizon, primal += l->moves, l = l->next)
        for (int k = 0; k < l->horizon; k++) {
            deviation[k] = l->blocked ? R(0.0) : primal[k];
            for (int b = 0; l->blocked && b < l->moves; b++) deviation[k] += l->blocking[k * l->moves + b] * primal[b];
        }
}

/* Whether the solution without rows fulfils all of them, which most steps find here; with soft limits they are built. */
static int primal_fits(const hystmpc_law *l, const hystmpc_task *t, const real *commands, const real *primal,
                       real *deviation) {
    int fits = hystmpc_program_slacks(l) == 0 && all_finite(primal, hystmpc_program_unknowns(l));
    if (fits) hystmpc_deviation(l, primal, deviation);
    for (; fits && law_moves(l); commands += l->horizon, deviation += l->horizon, primal += l->moves, l = l->next, t = t->next) {
        for (int k = 0; k < l->horizon; k++)
            fits &= l->lower - commands[k] <= deviation[k] && deviation[k] <= l->upper - commands[k];
        for (int b = 0; b < l->moves; b++) {
            const real move = b ? primal[b] - primal[b - 1] : primal[b];
            real low, high;
            bounds_of_move(l, t, commands, b, &low, &high);
            fits &= low <= move && move <= high;
        }
    }
    return fits;
}

HYSTMPC_LOCAL int hystmpc_solve_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                        const real *commands, const real *angles, const real *columns, int changes,
                                        real *deviation) {
    const int n = q->unknowns;
    build_cost(q, l, t, commands, angles, columns);
    if (!all_finite(q->gradient, n) || !all_finite(q->hessian, n * n)) return HYSTMPC_NO_PROGRAM;
    const int answer = hystmpc_solve_free(q);
    if (answer < 0 || primal_fits(l, t, commands, q->primal, deviation)) return answer;
    build_rows(q, l, t, commands, angles, columns);
    return hystmpc_solve_rows(q, changes);
}

HYSTMPC_LOCAL void hystmpc_after_moves(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                       const real *commands, const real *angles, const real *primal, real *foreseen,
                                       real *plan, real *cost) {
    const int samples = l->horizon, width = hystmpc_program_commands(l), rows = hystmpc_program_angles(l);
    const hystmpc_task *last = t;
    real *limited = plan;
    hystmpc_deviation(l, primal, plan);
    for (int k = 0; k < width; k++) plan[k] = commands[k] + plan[k];
    for (const hystmpc_law *i = l; law_moves(i); i = i->next, last = last->next, limited += samples)
        hystmpc_clip_plan(samples, i->lower, i->upper, i->reach, last->u_last, limited);
    for (int row = 0; row < rows; row++, jacobian += width) {
        real angle = angles[row];
        for (int first = 0; first < width; first += samples)
            for (int j = first; j <= first + row % samples; j++) angle += jacobian[j] * (plan[j] - commands[j]);
        foreseen[row] = angle;
    }
    *cost = hystmpc_plan_cost(l, t, plan, foreseen);
}

HYSTMPC_LOCAL int hystmpc_step_plan(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                    const real *commands, const real *angles, int changes, real *room, int *whole,
                                    real *plan, real *cost) {
    const int n = hystmpc_program_unknowns(l), rows = hystmpc_program_rows(l), slacks = hystmpc_program_slacks(l);
    const int slopes = hystmpc_program_angles(l) * hystmpc_program_commands(l);
    real *const behind = room + hystmpc_qp_reals(n, rows, slacks);
    hystmpc_qp q;
    hystmpc_place_qp(&q, n, rows, slacks, room, whole);
    if (l->blocked) hystmpc_block_columns(l, jacobian, behind);
    const int answer =
        hystmpc_solve_program(&q, l, t, commands, angles, l->blocked ? behind : jacobian, changes, plan);
    if (answer == HYSTMPC_NO_PROGRAM && !all_finite(jacobian, slopes)) return HYSTMPC_NO_JACOBIAN;
    if (answer >= 0) hystmpc_after_moves(l, t, jacobian, commands, angles, q.primal, behind, plan, cost);
    return answer;
}

HYSTMPC_LOCAL void hystmpc_part_plans(const hystmpc_law *l, const real *commands, const real *plan, real u_last,
                                      real *parts) {
    static const real shares[HYSTMPC_SHARES] = {R(0.5), R(0.25), R(0.125)};
    for (int i = 0; i < HYSTMPC_SHARES; i++, parts += l->horizon) {
        for (int k = 0; k < l->horizon; k++) parts[k] = commands[k] + shares[i] * (plan[k] - commands[k]);
        hystmpc_clip_plan(l->horizon, l->lower, l->upper, l->reach, u_last, parts);
    }
}
