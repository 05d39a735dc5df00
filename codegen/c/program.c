/* The condensed quadratic program around a plan, with and without move blocking. */
#include "internal.h"

static const real tracking[HYSTMPC_HORIZON] = HYSTMPC_TRACKING;

enum { MOVES = HYSTMPC_BLOCKS > 0 ? HYSTMPC_BLOCKS : HYSTMPC_HORIZON };

/* Soft angle limits: a free variable s a sample, with a <= theta_p + J v + s <= b at the cost w_s s^2. */
#if HYSTMPC_SOFT
static void soften(hystmpc_work *w, const problem *p, const plan *around, int first_row) {
    for (int k = 0; k < H; k++) {
        real *row = w->rows[first_row + k];
        row[MOVES + k] = R(1.0);
        w->hessian[MOVES + k][MOVES + k] = R(2.0) * HYSTMPC_SOFT_WEIGHT;
        w->lower[first_row + k] = p->low - around->angles[k];
        w->upper[first_row + k] = p->high - around->angles[k];
    }
}
#endif

/* All of the program zero, the first rows those of the identity. */
static void clear(hystmpc_work *w) {
    for (int i = 0; i < HYSTMPC_QP_SIZE; i++) {
        fill(w->hessian[i], R(0.0), HYSTMPC_QP_SIZE);
        w->gradient[i] = R(0.0);
    }
    for (int i = 0; i < HYSTMPC_QP_ROWS; i++) fill(w->rows[i], R(0.0), HYSTMPC_QP_SIZE);
    for (int i = 0; i < MOVES; i++) w->rows[i][i] = R(1.0);
    for (int i = 0; i < MOVES; i++) {
        w->rows[MOVES + i][i] = R(1.0);
        if (i) w->rows[MOVES + i][i - 1] = R(-1.0);
    }
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
    real moves[HYSTMPC_HORIZON];
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
        w->lower[b] = HYSTMPC_LOWER - around->commands[ends[b]];
        w->upper[b] = HYSTMPC_UPPER - around->commands[ends[b]];
        w->lower[MOVES + b] = length * least(-HYSTMPC_REACH - slowest, R(0.0));
        w->upper[MOVES + b] = length * most(HYSTMPC_REACH - fastest, R(0.0));
    }
    int row = 2 * MOVES, b = 0;
    for (int k = 0; k < H; k++) { /* the box between the ends of blocks */
        if (b < MOVES && k == ends[b]) {
            b++;
            continue;
        }
        copy(blocking[k], w->rows[row], MOVES);
        w->lower[row] = HYSTMPC_LOWER - around->commands[k];
        w->upper[row] = HYSTMPC_UPPER - around->commands[k];
        row++;
    }
#if HYSTMPC_SOFT
    for (int k = 0; k < H; k++) copy(w->jacobian[k], w->rows[row + k], MOVES);
    soften(w, p, around, row);
#endif
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
        w->lower[i] = HYSTMPC_LOWER - around->commands[i];
        w->upper[i] = HYSTMPC_UPPER - around->commands[i];
        w->lower[H + i] = -HYSTMPC_REACH - moves[i];
        w->upper[H + i] = HYSTMPC_REACH - moves[i];
    }
#if HYSTMPC_SOFT
    for (int k = 0; k < H; k++) copy(w->jacobian[k], w->rows[2 * H + k], H);
    soften(w, p, around, 2 * H);
#endif
}

HYSTMPC_LOCAL void deviation(const real *primal, real *commands) { copy(primal, commands, H); }

#endif
