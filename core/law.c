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

HYSTMPC_LOCAL real hystmpc_plan_cost(const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                                     const real *angles) {
    real total = R(0.0), before = t->u_last;
    for (int k = 0; k < l->horizon; k++) {
        const real error = angles[k] - t->reference[k], move = commands[k] - before;
        const real off = commands[k] - t->feedforward[k];
        total += l->tracking[k] * error * error + l->rate_weight * move * move + l->effort_weight * off * off;
        if (l->soft) {
            const real excess = most(angles[k] - t->high, R(0.0)) + most(t->low - angles[k], R(0.0));
            total += l->soft_weight * excess * excess;
        }
        before = commands[k];
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

/* A row for the command of each sample, one for each move, and one for the angle of each sample with soft limits. */
HYSTMPC_LOCAL int hystmpc_program_rows(const hystmpc_law *l) {
    return l->horizon + l->moves + hystmpc_program_slacks(l);
}

HYSTMPC_LOCAL int hystmpc_program_slacks(const hystmpc_law *l) { return l->soft ? l->horizon : 0; }

HYSTMPC_LOCAL void hystmpc_block_columns(const hystmpc_law *l, const real *jacobian, real *columns) {
    const int samples = l->horizon, m = l->moves;
    for (int k = 0; k < samples; k++) {
        for (int b = 0; b < m; b++) {
            const int stop = b + 2 < m ? l->starts[b + 2] : samples;
            real sum = R(0.0);
            for (int i = l->starts[b]; i <= k && i < stop; i++) sum += jacobian[k * samples + i] * l->blocking[i * m + b];
            columns[k * m + b] = sum;
        }
    }
}

/* Soft limits of the angle of sample k, which depends on the first `count` unknowns: a variable s of its own, with
 * a <= theta_p + J v + s <= b at the cost w_s s^2. Answers the row behind. */
static int soften(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, real angle, const real *slopes, int count,
                  int row) {
    if (!l->soft) return row;
    for (int j = 0; j < count; j++) q->columns[j * q->rows + row] = slopes[j];
    q->soft[row] = R(0.5) / l->soft_weight;
    q->lower[row] = t->low - angle;
    q->upper[row] = t->high - angle;
    return row + 1;
}

/* The command of a sample within the box, and the move from unknown i - 1 to unknown i within its bounds. */
static int bound_command(hystmpc_qp *q, const hystmpc_law *l, real command, int row) {
    q->lower[row] = l->lower - command;
    q->upper[row] = l->upper - command;
    return row + 1;
}

static int bound_move(hystmpc_qp *q, int i, real low, real high, int row) {
    q->columns[i * q->rows + row] = R(1.0);
    if (i) q->columns[(i - 1) * q->rows + row] = R(-1.0);
    q->lower[row] = low;
    q->upper[row] = high;
    return row + 1;
}

static real move_of(const hystmpc_task *t, const real *commands, int k) {
    return commands[k] - (k ? commands[k - 1] : t->u_last);
}

/* In the deviation v of the commands from the plan, theta(p + v) ~ theta_p + J v:
 *     P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f)) */
static void build_free(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                       const real *angles, const real *jacobian) {
    const real rate = R(2.0) * l->rate_weight, effort = R(2.0) * l->effort_weight;
    const int samples = l->horizon;
    int row = 0;
    for (int i = 0; i < samples; i++) {
        real *const hessian = q->hessian + i * samples;
        const real move = move_of(t, commands, i);
        real total = effort * (commands[i] - t->feedforward[i]) + rate * move;
        if (i + 1 < samples) total -= rate * move_of(t, commands, i + 1);
        for (int k = i; k < samples; k++) {
            const real *const slopes = jacobian + k * samples, weighted = R(2.0) * l->tracking[k] * slopes[i];
            total += weighted * (angles[k] - t->reference[k]);
            for (int j = 0; j <= i; j++) hessian[j] += weighted * slopes[j];
        }
        hessian[i] += effort + (i + 1 < samples ? R(2.0) * rate : rate);
        if (i) hessian[i - 1] -= rate;
        q->gradient[i] = total;
        q->columns[i * q->rows + row] = R(1.0);
        row = bound_command(q, l, commands[i], row);
        row = bound_move(q, i, -l->reach - move, l->reach - move, row);
        row = soften(q, l, t, angles[i], jacobian + i * samples, i + 1, row);
    }
}

/* Cost in the deviations w at the ends of blocks, v = M w. */
static void blocked_cost(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                         const real *angles, const real *columns) {
    const int samples = l->horizon, m = l->moves;
    for (int b = 0; b < m; b++) {
        real sum = R(0.0);
        for (int k = 0; k < samples; k++) {
            const real here = l->blocking[k * m + b], before = k ? l->blocking[(k - 1) * m + b] : R(0.0);
            sum += R(2.0) * l->rate_weight * (here - before) * move_of(t, commands, k);
            sum += R(2.0) * l->effort_weight * here * (commands[k] - t->feedforward[k]);
        }
        for (int k = l->starts[b]; k < samples; k++)
            sum += R(2.0) * l->tracking[k] * (angles[k] - t->reference[k]) * columns[k * m + b];
        q->gradient[b] = sum;
        for (int a = 0; a <= b; a++) {
            real total = l->constant[a * m + b];
            for (int k = l->starts[b]; k < samples; k++)
                total += R(2.0) * l->tracking[k] * columns[k * m + a] * columns[k * m + b];
            q->hessian[b * m + a] = total;
        }
    }
}

/* The move of v is one number in a block, so is its rate limit: the plan's greatest move in the block decides. The plan
 * is admissible but for rounding, so that no move always is. */
static int bound_block(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t, const real *commands, int b, int row) {
    real slowest = move_of(t, commands, l->starts[b]), fastest = slowest;
    for (int k = l->starts[b] + 1; k <= l->ends[b]; k++) {
        slowest = least(slowest, move_of(t, commands, k));
        fastest = most(fastest, move_of(t, commands, k));
    }
    const real length = (real)(l->ends[b] + 1 - l->starts[b]);
    return bound_move(q, b, length * least(-l->reach - slowest, R(0.0)), length * most(l->reach - fastest, R(0.0)), row);
}

HYSTMPC_LOCAL void hystmpc_build_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                         const real *commands, const real *angles, const real *columns) {
    const int m = l->moves;
    if (!l->blocked) {
        build_free(q, l, t, commands, angles, columns);
        return;
    }
    blocked_cost(q, l, t, commands, angles, columns);
    for (int k = 0, b = 0, row = 0; k < l->horizon; k++) { /* b: the block of sample k, the last one behind all blocks */
        if (b + 1 < m && k == l->starts[b + 1]) b++;
        if (k == l->starts[b]) row = bound_block(q, l, t, commands, b, row);
        for (int i = b ? b - 1 : 0; i <= b; i++) q->columns[i * q->rows + row] = l->blocking[k * m + i];
        row = bound_command(q, l, commands[k], row);
        row = soften(q, l, t, angles[k], columns + k * m, b + 1, row);
    }
}

HYSTMPC_LOCAL void hystmpc_deviation(const hystmpc_law *l, const real *primal, real *deviation) {
    const int m = l->moves;
    for (int k = 0; k < l->horizon; k++) {
        deviation[k] = l->blocked ? R(0.0) : primal[k];
        for (int b = 0; l->blocked && b < m; b++) deviation[k] += l->blocking[k * m + b] * primal[b];
    }
}

HYSTMPC_LOCAL void hystmpc_after_moves(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                       const real *commands, const real *angles, const real *primal, real *foreseen,
                                       real *plan, real *cost) {
    const int samples = l->horizon;
    hystmpc_deviation(l, primal, plan);
    for (int k = 0; k < samples; k++) plan[k] = commands[k] + plan[k];
    hystmpc_clip_plan(samples, l->lower, l->upper, l->reach, t->u_last, plan);
    for (int k = 0; k < samples; k++) {
        foreseen[k] = angles[k];
        for (int j = 0; j <= k; j++) foreseen[k] += jacobian[k * samples + j] * (plan[j] - commands[j]);
    }
    *cost = hystmpc_plan_cost(l, t, plan, foreseen);
}

HYSTMPC_LOCAL int hystmpc_step_plan(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                    const real *commands, const real *angles, int changes, real *room, int *whole,
                                    real *plan, real *cost) {
    const int m = l->moves, rows = hystmpc_program_rows(l), slacks = hystmpc_program_slacks(l);
    real *const behind = room + hystmpc_qp_reals(m, rows, slacks);
    hystmpc_qp q;
    hystmpc_place_qp(&q, m, rows, slacks, room, whole);
    if (l->blocked) hystmpc_block_columns(l, jacobian, behind);
    hystmpc_build_program(&q, l, t, commands, angles, l->blocked ? behind : jacobian);
    if (!all_finite(q.gradient, m) || !all_finite(q.hessian, m * m))
        return all_finite(jacobian, l->horizon * l->horizon) ? HYSTMPC_NO_PROGRAM : HYSTMPC_NO_JACOBIAN;
    const int answer = hystmpc_solve_qp(&q, changes);
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
