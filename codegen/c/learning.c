/* A bank of Kalman filters, one for each drive of a grid: they learn weights, and their forecasts are judged. */
#include "internal.h"

#if HYSTMPC_LEARNS

enum { K = HYSTMPC_UNKNOWNS, DRIVES = HYSTMPC_DRIVES, MODEL_ALONE = HYSTMPC_DRIVES, LAST_ANGLE = HYSTMPC_DRIVES + 1 };

static const real lags[HYSTMPC_LAGS] = HYSTMPC_LAG_SHARES;
static const real prior[HYSTMPC_UNKNOWNS] = HYSTMPC_PRIOR;
static const real growth[HYSTMPC_UNKNOWNS] = HYSTMPC_GROWTH;
static const real walk[HYSTMPC_UNKNOWNS] = HYSTMPC_WALK;
static const real resting[HYSTMPC_PLAYS] = HYSTMPC_RADII;

/* At rest under the command u, the model at `angle` and the measurement at `y`. */
HYSTMPC_LOCAL void learning_init(hystmpc_learning *l, real angle, real u, real y) {
    const real v = (u - HYSTMPC_RANGE_LOW) / HYSTMPC_RANGE_SPAN;
    const real side = v < R(0.5) ? R(1.0) : R(-1.0); /* a device near one end of its command has come from the other */
    for (int t = 0; t < HYSTMPC_HISTORY; t++) {
        for (int lag = 0; lag < HYSTMPC_LAGS; lag++) {
            real *memory = l->history[t][lag];
            fill(memory, v, HYSTMPC_MEMORY);
            for (int i = 0; i < HYSTMPC_PLAYS; i++) memory[1 + i] = v + side * resting[i];
        }
    }
    fill(l->queue, v, HYSTMPC_DELAYS);
    l->start[0] = v;
    l->start[1] = side;
    l->start[2] = angle;
    for (int n = 0; n < DRIVES; n++) {
        fill(l->z[n], R(0.0), K);
        l->z[n][0] = y - angle;
        copy(l->z[n], l->frozen[n], K);
        for (int a = 0; a < K; a++) {
            fill(l->covariance[n][a], R(0.0), K);
            l->covariance[n][a][a] = prior[a];
        }
    }
    l->references[0] = y - angle;
    l->references[1] = y;
    fill(l->sums, R(0.0), DRIVES + 2);
    fill(l->scores, R(0.0), DRIVES + 2);
    l->distrust = l->share = R(0.0);
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
        for (int lag = 0; lag < HYSTMPC_LAGS; lag++) copy(l->history[t - 1][lag], l->history[t][lag], HYSTMPC_MEMORY);
    for (int lag = 0; lag < HYSTMPC_LAGS; lag++) advance_memory(l->history[0][lag], x, lags[lag]);
    for (int k = HYSTMPC_DELAYS - 1; k > 0; k--) l->queue[k] = l->queue[k - 1];
    l->queue[0] = x;
}

/* One measurement for one drive. `still`: the command rests; no weight can have changed then, and a large error is a
 * jump of the offset. */
static void correct_filter(real *z, real (*p)[HYSTMPC_UNKNOWNS], const real *h, real error, int still) {
    real spread[HYSTMPC_UNKNOWNS] = {R(0.0)}, variance = HYSTMPC_LEARNING_NOISE;
    for (int b = 0; b < K; b++)
        for (int a = 0; a < K; a++) spread[a] += p[b][a] * h[b];
    for (int a = 0; a < K; a++) variance += h[a] * spread[a];
    if (!(HYSTMPC_LEARNING_NOISE <= variance && finite(variance) && finite(error))) {
        for (int a = 0; a < K; a++) { /* rounding has eaten the covariance */
            fill(p[a], R(0.0), K);
            p[a][a] = prior[a];
        }
        return;
    }
    if (still && error * error > HYSTMPC_SURPRISE * variance) {
        p[0][0] += error * error;
        spread[0] += error * error;
        variance += error * error;
    }
    for (int a = 0; a < K; a++) {
        const real share = spread[a] / variance;
        z[a] += share * error;
        for (int b = 0; b < K; b++) p[a][b] -= share * spread[b];
    }
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
    l->distrust = HYSTMPC_RECENT * l->distrust + (R(1.0) - HYSTMPC_RECENT) * least(off, HYSTMPC_WORST);
    l->blocks++;
    l->share = clamp((gained - HYSTMPC_LEAST_GAIN) / HYSTMPC_FULL_GAIN, R(0.0), R(1.0));
}

/* With a measurement used: `angle` is the model's at that instant, `disturbance` its own before this measurement. */
HYSTMPC_LOCAL void learning_correct(hystmpc_learning *l, real y, real angle, real disturbance) {
    const real travel = absolute(l->history[HYSTMPC_DELAY][0][0] - l->history[HYSTMPC_DELAY + 1][0][0]);
    real h[HYSTMPC_UNKNOWNS];
    for (int n = 0; n < DRIVES; n++) {
        const int lag = n / HYSTMPC_DELAYS, at = n % HYSTMPC_DELAYS + HYSTMPC_DELAY;
        features(l->history[at][lag], l->history[at + 1][lag][0], l->start[0], l->start[1], h + 2);
        h[0] = R(1.0);
        h[1] = angle - l->start[2];
        real error = y - angle, forecast = y - angle;
        for (int a = 0; a < K; a++) {
            error -= h[a] * l->z[n][a];
            forecast -= h[a] * l->frozen[n][a];
        }
        l->sums[n] += forecast * forecast;
        correct_filter(l->z[n], l->covariance[n], h, error, travel == R(0.0));
        for (int a = 0; a < K; a++) {
            const real now = l->covariance[n][a][a], grown = now + growth[a] + walk[a] * travel;
            l->covariance[n][a][a] = least(grown, most(prior[a], now));
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
    for (int n = 0; n < DRIVES; n++) copy(l->z[n], l->frozen[n], K);
    l->references[0] = disturbance;
    l->references[1] = y;
}

/* What the learned part adds to the model's angle, whose features are `back` samples old. */
HYSTMPC_LOCAL real learning_added(const hystmpc_learning *l, real angle, int back) {
    if (l->share == R(0.0)) return R(0.0);
    const int lag = l->best / HYSTMPC_DELAYS, at = l->best % HYSTMPC_DELAYS + back;
    const real *weights = l->z[l->best] + 1;
    real f[HYSTMPC_WEIGHTS], total = R(0.0);
    features(l->history[at][lag], l->history[at + 1][lag][0], l->start[0], l->start[1], f);
    for (int i = 0; i < HYSTMPC_WEIGHTS - 1; i++) total += l->share * weights[1 + i] * f[i];
    return l->share * weights[0] * (angle - l->start[2]) + total;
}

/* The learned part of the state that predictions start from. */
HYSTMPC_LOCAL void learning_state(const hystmpc_learning *l, hystmpc_state *s) {
    s->delay = l->best % HYSTMPC_DELAYS;
    s->share = lags[l->best / HYSTMPC_DELAYS];
    copy(l->history[s->delay][l->best / HYSTMPC_DELAYS], s->memory, HYSTMPC_MEMORY);
    copy(l->queue, s->queue, HYSTMPC_DELAYS);
    copy(l->start, s->start, 3);
    s->acts = 0;
    for (int i = 0; i < HYSTMPC_WEIGHTS; i++) {
        s->weights[i] = l->share * l->z[l->best][1 + i];
        if (s->weights[i] != R(0.0)) s->acts = 1;
    }
}

#endif
