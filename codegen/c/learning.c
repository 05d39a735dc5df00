/* A bank of Kalman filters, one for each drive of a grid: they learn weights, and their forecasts are judged. */
#include "internal.h"

#if HYSTMPC_LEARNS

enum {
    K = HYSTMPC_UNKNOWNS,
    DELAYS = HYSTMPC_DELAYS,
    LAGS = HYSTMPC_LAGS, /* of a delay, side by side: each operation is one on a vector of all of them */
    DRIVES = HYSTMPC_DRIVES,
    MODEL_ALONE = HYSTMPC_DRIVES,
    LAST_ANGLE = HYSTMPC_DRIVES + 1
};

static const real lags[HYSTMPC_LAGS] = HYSTMPC_LAG_SHARES;
static const real prior[HYSTMPC_UNKNOWNS] = HYSTMPC_PRIOR;
static const real growth[HYSTMPC_UNKNOWNS] = HYSTMPC_GROWTH;
static const real walk[HYSTMPC_UNKNOWNS] = HYSTMPC_WALK;
static const real resting[HYSTMPC_PLAYS] = HYSTMPC_RADII;

/* The covariance of one lag before anything has been learned. */
static void start_covariance(real (*p)[HYSTMPC_LAGS], int lag) {
    for (int a = 0, at = 0; a < K; a++)
        for (int b = 0; b <= a; b++, at++) p[at][lag] = a == b ? prior[a] : R(0.0);
}

/* Forecasts start from the present weights. */
static void freeze(hystmpc_learning *l) {
    for (int delay = 0; delay < DELAYS; delay++)
        for (int a = 0; a < K; a++) copy(l->z[delay][a], l->frozen[delay][a], LAGS);
}

/* At rest under the command u, the model at `angle` and the measurement at `y`. */
HYSTMPC_LOCAL void learning_init(hystmpc_learning *l, real angle, real u, real y) {
    const real v = (u - HYSTMPC_RANGE_LOW) / HYSTMPC_RANGE_SPAN;
    const real side = v < R(0.5) ? R(1.0) : R(-1.0); /* a device near one end of its command has come from the other */
    for (int t = 0; t < HYSTMPC_HISTORY; t++) {
        for (int i = 0; i < HYSTMPC_MEMORY; i++) fill(l->history[t][i], v, LAGS);
        for (int i = 0; i < HYSTMPC_PLAYS; i++) fill(l->history[t][1 + i], v + side * resting[i], LAGS);
    }
    fill(l->queue, v, HYSTMPC_DELAYS);
    l->start[0] = v;
    l->start[1] = side;
    l->start[2] = angle;
    for (int delay = 0; delay < DELAYS; delay++) {
        for (int a = 0; a < K; a++) fill(l->z[delay][a], a ? R(0.0) : y - angle, LAGS);
        for (int lag = 0; lag < LAGS; lag++) start_covariance(l->covariance[delay], lag);
    }
    freeze(l);
    l->references[0] = y - angle;
    l->references[1] = y;
    fill(l->sums, R(0.0), DRIVES + 2);
    fill(l->scores, R(0.0), DRIVES + 2);
    l->forecast_error = l->share = R(0.0);
    l->count = l->blocks = l->best = 0;
    fill(l->added, R(0.0), HYSTMPC_UNDER_WAY);
}

/* How far the angle may have moved under the last commands: twice what the mean slope says. */
HYSTMPC_LOCAL real learning_reach(const hystmpc_learning *l) {
    real low = l->queue[0], high = l->queue[0];
    for (int k = 1; k < HYSTMPC_DELAYS; k++) {
        low = least(low, l->queue[k]);
        high = most(high, l->queue[k]);
    }
    return R(2.0) * HYSTMPC_SCALE * (high - low);
}

/* One sample later under the command u. */
HYSTMPC_LOCAL void learning_advance(hystmpc_learning *l, real u) {
    const real x = (u - HYSTMPC_RANGE_LOW) / HYSTMPC_RANGE_SPAN;
    for (int t = HYSTMPC_HISTORY - 1; t > 0; t--)
        for (int i = 0; i < HYSTMPC_MEMORY; i++) copy(l->history[t - 1][i], l->history[t][i], LAGS);
    advance_memory(l->history[0][0], LAGS, x, lags);
    for (int k = HYSTMPC_DELAYS - 1; k > 0; k--) l->queue[k] = l->queue[k - 1];
    l->queue[0] = x;
}

/* One measurement for all lags of a delay. Of each covariance the lower triangle is stored, row by row. `still`: the
 * command rests; no weight can have changed then, and a large error is a jump of the offset. */
static void correct_filters(real (*z)[HYSTMPC_LAGS], real (*p)[HYSTMPC_LAGS], real (*h)[HYSTMPC_LAGS], const real *error,
                            int still) {
    real spread[HYSTMPC_UNKNOWNS][HYSTMPC_LAGS], variance[HYSTMPC_LAGS], shrunk[HYSTMPC_LAGS];
    int usable[HYSTMPC_LAGS];
    for (int a = 0, at = 0; a < K; a++, at++) {
        real own[HYSTMPC_LAGS] = {R(0.0)};
        for (int b = 0; b < a; b++, at++) {
            for (int i = 0; i < LAGS; i++) {
                own[i] += p[at][i] * h[b][i];
                spread[b][i] += p[at][i] * h[a][i];
            }
        }
        for (int i = 0; i < LAGS; i++) spread[a][i] = own[i] + p[at][i] * h[a][i];
    }
    fill(variance, HYSTMPC_LEARNING_NOISE, LAGS);
    for (int a = 0; a < K; a++)
        for (int i = 0; i < LAGS; i++) variance[i] += h[a][i] * spread[a][i];
    for (int i = 0; i < LAGS; i++) {
        const real square = error[i] * error[i];
        usable[i] = HYSTMPC_LEARNING_NOISE <= variance[i] && finite(variance[i]) && finite(error[i]);
        const real jump = still && square > HYSTMPC_SURPRISE * variance[i] ? square : R(0.0);
        p[0][i] += jump;
        spread[0][i] += jump;
        shrunk[i] = R(1.0) / root(variance[i] + jump);
    }
    for (int a = 0, at = 0; a < K; a++) {
        for (int i = 0; i < LAGS; i++) {
            spread[a][i] *= shrunk[i];
            z[a][i] = usable[i] ? z[a][i] + spread[a][i] * (shrunk[i] * error[i]) : z[a][i];
        }
        for (int b = 0; b <= a; b++, at++)
            for (int i = 0; i < LAGS; i++) p[at][i] -= spread[a][i] * spread[b][i];
    }
    for (int i = 0; i < LAGS; i++)
        if (!usable[i]) start_covariance(p, i); /* rounding has eaten the covariance */
}

/* What a block of forecasts says: the scores, the drive that is used, how far it acts. */
static void judge(hystmpc_learning *l, const real *means) {
    if (means[LAST_ANGLE] <= HYSTMPC_MOVING * HYSTMPC_LEARNING_NOISE) return;
    const real kept = least(HYSTMPC_KEPT, (real)l->blocks / ((real)l->blocks + R(1.0)));
    int first = 0;
    for (int n = 0; n < DRIVES + 2; n++) l->scores[n] = kept * l->scores[n] + (R(1.0) - kept) * means[n];
    for (int n = 1; n < DRIVES; n++)
        if (l->scores[n] < l->scores[first]) first = n;
    if (l->scores[first] < HYSTMPC_BETTER * l->scores[l->best]) l->best = first;
    const real gained =
        R(1.0) - (l->scores[l->best] + HYSTMPC_FLOOR) / (l->scores[MODEL_ALONE] + HYSTMPC_FLOOR);
    const real off = root(least(means[MODEL_ALONE], means[l->best]) / means[LAST_ANGLE]);
    l->forecast_error = HYSTMPC_RECENT * l->forecast_error + (R(1.0) - HYSTMPC_RECENT) * least(off, HYSTMPC_WORST);
    l->blocks++;
    l->share = clamp((gained - HYSTMPC_LEAST_GAIN) / HYSTMPC_FULL_GAIN, R(0.0), R(1.0));
}

/* With a measurement used: `angle` is the model's at that instant, `disturbance` its own before this measurement. */
HYSTMPC_LOCAL void learning_correct(hystmpc_learning *l, real y, real angle, real disturbance) {
    const real travel = absolute(l->history[HYSTMPC_DELAY][0][0] - l->history[HYSTMPC_DELAY + 1][0][0]);
    for (int delay = 0; delay < DELAYS; delay++) {
        real(*z)[HYSTMPC_LAGS] = l->z[delay], (*p)[HYSTMPC_LAGS] = l->covariance[delay];
        real h[HYSTMPC_UNKNOWNS][HYSTMPC_LAGS], error[HYSTMPC_LAGS], forecast[HYSTMPC_LAGS];
        const int at = delay + HYSTMPC_DELAY;
        features(l->history[at][0], l->history[at + 1][0], LAGS, l->start[0], l->start[1], h[2]);
        fill(h[0], R(1.0), LAGS);
        fill(h[1], angle - l->start[2], LAGS);
        fill(error, y - angle, LAGS);
        fill(forecast, y - angle, LAGS);
        for (int a = 0; a < K; a++) {
            for (int i = 0; i < LAGS; i++) {
                error[i] -= h[a][i] * z[a][i];
                forecast[i] -= h[a][i] * l->frozen[delay][a][i];
            }
        }
        for (int lag = 0; lag < LAGS; lag++) l->sums[lag * DELAYS + delay] += forecast[lag] * forecast[lag];
        correct_filters(z, p, h, error, travel == R(0.0));
        for (int a = 0; a < K; a++) {
            real *own = p[a * (a + 3) / 2];
            for (int i = 0; i < LAGS; i++) {
                const real grown = own[i] + growth[a] + walk[a] * travel;
                own[i] = least(grown, most(prior[a], own[i]));
            }
        }
    }
    const real own = y - angle - l->references[0], none = y - l->references[1];
    l->sums[MODEL_ALONE] += own * own;
    l->sums[LAST_ANGLE] += none * none;
    l->count++;
    if (l->count < HYSTMPC_BLOCK) return;
    real means[HYSTMPC_DRIVES + 2];
    for (int n = 0; n < DRIVES + 2; n++) means[n] = l->sums[n] / (real)l->count;
    judge(l, means);
    fill(l->sums, R(0.0), DRIVES + 2);
    l->count = 0;
    freeze(l);
    l->references[0] = disturbance;
    l->references[1] = y;
}

/* The memory behind one lag, so many samples ago. */
static void memory_of(const hystmpc_learning *l, int at, int lag, real *memory) {
    for (int i = 0; i < HYSTMPC_MEMORY; i++) memory[i] = l->history[at][i][lag];
}

/* What the learned part adds to the model's angle, whose features are `back` samples old. */
HYSTMPC_LOCAL real learning_added(const hystmpc_learning *l, real angle, int back) {
    if (l->share == R(0.0)) return R(0.0);
    const int lag = l->best / DELAYS, delay = l->best % DELAYS, at = delay + back;
    real memory[HYSTMPC_MEMORY], f[HYSTMPC_WEIGHTS], total = R(0.0);
    memory_of(l, at, lag, memory);
    features(memory, &l->history[at + 1][0][lag], 1, l->start[0], l->start[1], f);
    for (int i = 0; i < HYSTMPC_WEIGHTS - 1; i++) total += l->share * l->z[delay][2 + i][lag] * f[i];
    return l->share * l->z[delay][1][lag] * (angle - l->start[2]) + total;
}

/* The learned part of the state that predictions start from. */
HYSTMPC_LOCAL void learning_state(const hystmpc_learning *l, hystmpc_state *s) {
    const int lag = l->best / DELAYS;
    s->delay = l->best % DELAYS;
    s->share = lags[lag];
    memory_of(l, s->delay, lag, s->memory);
    copy(l->queue, s->queue, HYSTMPC_DELAYS);
    copy(l->start, s->start, 3);
    s->acts = 0;
    for (int i = 0; i < HYSTMPC_WEIGHTS; i++) {
        s->weights[i] = l->share * l->z[s->delay][1 + i][lag];
        if (s->weights[i] != R(0.0)) s->acts = 1;
    }
}

#endif
