/* The condensed quadratic program around a plan, with and without move blocking. */
#include "internal.h"

static const real tracking[HYSTMPC_HORIZON] = HYSTMPC_TRACKING;

enum { MOVES = HYSTMPC_QP_MOVES };

/* All of the program zero. */
static void clear(hystmpc_work *w) {
    for (int i = 0; i < MOVES; i++) {
        fill(w->hessian[i], R(0.0), MOVES);
        fill(w->columns[i], R(0.0), HYSTMPC_QP_ROWS);
    }
    fill(w->soft, R(0.0), HYSTMPC_QP_ROWS);
}

/* Soft limits of the angle of sample k, which depends on the first `count` unknowns: a variable s of its own, with
 * a <= theta_p + J v + s <= b at the cost w_s s^2. Answers the row behind. */
static int soften(hystmpc_work *w, const problem *p, const plan *around, int k, int count, int row) {
#if HYSTMPC_SOFT
    for (int j = 0; j < count; j++) w->columns[j][row] = w->jacobian[k][j];
    w->soft[row] = R(0.5) / HYSTMPC_SOFT_WEIGHT;
    w->lower[row] = p->low - around->angles[k];
    w->upper[row] = p->high - around->angles[k];
    return row + 1;
#else
    (void)w, (void)p, (void)around, (void)k, (void)count;
    return row;
#endif
}

/* The command of sample k within the box, and the move from unknown i - 1 to unknown i within its bounds. */
static int bound_command(hystmpc_work *w, const plan *around, int k, int row) {
    w->lower[row] = HYSTMPC_LOWER - around->commands[k];
    w->upper[row] = HYSTMPC_UPPER - around->commands[k];
    return row + 1;
}

static int bound_move(hystmpc_work *w, int i, real low, real high, int row) {
    w->columns[i][row] = R(1.0);
    if (i) w->columns[i - 1][row] = R(-1.0);
    w->lower[row] = low;
    w->upper[row] = high;
    return row + 1;
}

#if HYSTMPC_BLOCKS

static const int starts[HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_STARTS;
static const int ends[HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_ENDS;
static const real blocking[HYSTMPC_HORIZON][HYSTMPC_BLOCKS] = HYSTMPC_BLOCKING;
static const real constant[HYSTMPC_BLOCKS][HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_CONSTANT;

/* J M in the place of J: no column is written before it has been read. */
static void block_columns(hystmpc_work *w) {
    real row[HYSTMPC_BLOCKS];
    for (int k = 0; k < H; k++) {
        for (int b = 0; b < MOVES; b++) {
            const int stop = b + 2 < MOVES ? starts[b + 2] : H;
            row[b] = R(0.0);
            for (int i = starts[b]; i <= k && i < stop; i++) row[b] += w->jacobian[k][i] * blocking[i][b];
        }
        copy(row, w->jacobian[k], MOVES);
    }
}

/* In the deviations w at the ends of blocks, v = M w: the move of v is one number a block, so is its rate limit. */
HYSTMPC_LOCAL void build_program(hystmpc_work *w, const problem *p, const plan *around) {
    real moves[HYSTMPC_HORIZON], least_move[HYSTMPC_BLOCKS], greatest_move[HYSTMPC_BLOCKS];
    clear(w);
    block_columns(w);
    for (int k = 0; k < H; k++) moves[k] = around->commands[k] - (k ? around->commands[k - 1] : p->u_last);
    for (int b = 0; b < MOVES; b++) {
        real sum = R(0.0);
        for (int k = 0; k < H; k++) {
            const real before = k ? blocking[k - 1][b] : R(0.0);
            sum += R(2.0) * HYSTMPC_RATE_WEIGHT * (blocking[k][b] - before) * moves[k];
            sum += R(2.0) * HYSTMPC_EFFORT_WEIGHT * blocking[k][b] * (around->commands[k] - p->feedforward[k]);
        }
        for (int k = starts[b]; k < H; k++)
            sum += R(2.0) * tracking[k] * (around->angles[k] - p->reference[k]) * w->jacobian[k][b];
        w->gradient[b] = sum;
        for (int a = 0; a <= b; a++) {
            real total = constant[a][b];
            for (int k = starts[b]; k < H; k++)
                total += R(2.0) * tracking[k] * w->jacobian[k][a] * w->jacobian[k][b];
            w->hessian[b][a] = total;
        }
        real slowest = moves[starts[b]], fastest = moves[starts[b]];
        for (int k = starts[b] + 1; k <= ends[b]; k++) {
            slowest = least(slowest, moves[k]);
            fastest = most(fastest, moves[k]);
        }
        const real length = (real)(ends[b] + 1 - starts[b]);
        least_move[b] = length * least(-HYSTMPC_REACH - slowest, R(0.0));
        greatest_move[b] = length * most(HYSTMPC_REACH - fastest, R(0.0));
    }
    for (int k = 0, b = 0, row = 0; k < H; k++) { /* b: the block of sample k, the last one behind all blocks */
        if (b + 1 < MOVES && k == starts[b + 1]) b++;
        if (k == starts[b]) row = bound_move(w, b, least_move[b], greatest_move[b], row);
        for (int i = b ? b - 1 : 0; i <= b; i++) w->columns[i][row] = blocking[k][i];
        row = bound_command(w, around, k, row);
        row = soften(w, p, around, k, b + 1, row);
    }
}

HYSTMPC_LOCAL void deviation(const real *primal, real *commands) {
    for (int k = 0; k < H; k++) {
        commands[k] = R(0.0);
        for (int b = 0; b < MOVES; b++) commands[k] += blocking[k][b] * primal[b];
    }
}

#else

/* In the deviation v of the commands from the plan, theta(p + v) ~ theta_p + J v:
 *     P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f)) */
HYSTMPC_LOCAL void build_program(hystmpc_work *w, const problem *p, const plan *around) {
    const real rate = R(2.0) * HYSTMPC_RATE_WEIGHT, effort = R(2.0) * HYSTMPC_EFFORT_WEIGHT;
    real moves[HYSTMPC_HORIZON];
    int row = 0;
    clear(w);
    for (int k = 0; k < H; k++) moves[k] = around->commands[k] - (k ? around->commands[k - 1] : p->u_last);
    for (int i = 0; i < H; i++) {
        real total = effort * (around->commands[i] - p->feedforward[i]) + rate * moves[i];
        if (i + 1 < H) total -= rate * moves[i + 1];
        for (int k = i; k < H; k++) {
            const real weighted = R(2.0) * tracking[k] * w->jacobian[k][i];
            total += weighted * (around->angles[k] - p->reference[k]);
            for (int j = 0; j <= i; j++) w->hessian[i][j] += weighted * w->jacobian[k][j];
        }
        w->hessian[i][i] += effort + (i + 1 < H ? R(2.0) * rate : rate);
        if (i) w->hessian[i][i - 1] -= rate;
        w->gradient[i] = total;
        w->columns[i][row] = R(1.0);
        row = bound_command(w, around, i, row);
        row = bound_move(w, i, -HYSTMPC_REACH - moves[i], HYSTMPC_REACH - moves[i], row);
        row = soften(w, p, around, i, i + 1, row);
    }
}

HYSTMPC_LOCAL void deviation(const real *primal, real *commands) { copy(primal, commands, H); }

#endif
