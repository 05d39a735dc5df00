/* Kalman filters of z = (d, w_c, w) for every drive of the grid, with scores of their forecasts:
 *
 *     y_k = m_k + h_k' z_k + v_k,   h = (1, m - m_0, f),   var(v) = r
 *     s = h' P h + r,  z <- z + P h (y - m - h' z) / s,  P <- P - P h h' P / s,  P <- P + Q
 *
 * By Q the offset drifts, but the weights change with the travel of the command only. All z are frozen at the beginning
 * of a block, and each drive predicts the angles of the block from the commands alone; so do the model with its
 * disturbance, and the last angle held. The best drive acts as far as it predicts clearly better than the model. */
#include "learning.h"

enum {
    LEARN_UNKNOWNS = HYSTMPC_UNKNOWNS,
    LEARN_DELAYS = HYSTMPC_DELAYS,
    LEARN_LAGS = HYSTMPC_LAGS, /* of a delay, side by side: each operation is one on a vector of all of them */
    LEARN_DRIVES = HYSTMPC_DRIVES,
    LEARN_MODEL_ALONE = HYSTMPC_DRIVES,
    LEARN_LAST_ANGLE = HYSTMPC_DRIVES + 1,
    LEARN_INSTANT = HYSTMPC_MEMORY * HYSTMPC_LAGS, /* numbers of the history of an instant */
    LEARN_QUEUE = 3,
    LEARN_HISTORY = LEARN_QUEUE + HYSTMPC_DELAYS
};

#define LEARN_BETTER R(0.8)     /* share of the present score at which another drive is taken */
#define LEARN_FULL_GAIN R(0.3)  /* over the model's score, beyond the least one, for the learned part's full effect */
#define LEARN_ALIKE R(2.0)     /* blocks before the first one, in which all miss by the noise of the filters */
#define LEARN_MOVING R(2.0)     /* variances of the filters by which an angle has to move in a block that counts */
#define LEARN_RECENT R(0.8)     /* forgetting factor of the errors that a supervisor uses, a block */
#define LEARN_WORST R(1.2)      /* error of a block is limited to this: one bad block is weak evidence */
#define LEARN_ANSWER R(0.3)     /* share of its answer to the way to an end of the range that a model keeps */
#define LEARN_FAR R(0.1)        /* least way to an end that is looked at, as a share of the range */
#define LEARN_SURPRISE R(9.0)   /* variances of an error in a hold, from which on it is an offset that has jumped */

/* The covariance of one lag before anything has been learned: free weights, and changes that are likely as a whole. */
static void start_covariance(const hystmpc_learner *n, real (*p)[HYSTMPC_LAGS], int lag) {
    const real *first = n->likely, *second = n->likely + LEARN_UNKNOWNS;
    for (int a = 0, at = 0; a < LEARN_UNKNOWNS; a++)
        for (int b = 0; b <= a; b++, at++)
            p[at][lag] = (a == b ? n->prior[a] : R(0.0)) + first[a] * first[b] + second[a] * second[b];
}

/* Forecasts start from the present weights. */
static void freeze(hystmpc_filters *l) {
    for (int delay = 0; delay < LEARN_DELAYS; delay++)
        for (int a = 0; a < LEARN_UNKNOWNS; a++)
            for (int i = 0; i < LEARN_LAGS; i++) l->frozen[delay][a][i] = l->z[delay][a][i];
}

HYSTMPC_LOCAL void hystmpc_learning_init(const hystmpc_learner *n, real *past, hystmpc_filters *l, real angle, real u,
                                         real y) {
    const real v = hystmpc_share_of_range(&n->basis, u);
    const real side = v < R(0.5) ? R(1.0) : R(-1.0); /* a device near one end of its command has come from the other */
    past[0] = v;
    past[1] = side;
    past[2] = angle;
    for (int k = 0; k < LEARN_DELAYS; k++) past[LEARN_QUEUE + k] = v;
    for (int t = 0; t <= LEARN_DELAYS + n->delay; t++)
        hystmpc_rest_memory(past + LEARN_HISTORY + t * LEARN_INSTANT, LEARN_LAGS, v, side);
    for (int delay = 0; delay < LEARN_DELAYS; delay++) {
        for (int a = 0; a < LEARN_UNKNOWNS; a++)
            for (int i = 0; i < LEARN_LAGS; i++) l->z[delay][a][i] = a ? R(0.0) : y - angle;
        for (int lag = 0; lag < LEARN_LAGS; lag++) start_covariance(n, l->covariance[delay], lag);
    }
    freeze(l);
    l->references[0] = y - angle;
    l->references[1] = y;
    for (int i = 0; i < LEARN_DRIVES + 2; i++) l->sums[i] = l->scores[i] = R(0.0);
    l->forecast_error = l->share = l->waited = l->travelled = R(0.0);
    l->count = l->blocks = l->best = 0;
}

HYSTMPC_LOCAL real hystmpc_learning_reach(const hystmpc_learner *n, const real *past) {
    const real *queue = past + LEARN_QUEUE;
    real low = queue[0], high = queue[0];
    for (int k = 1; k < LEARN_DELAYS; k++) {
        low = least(low, queue[k]);
        high = most(high, queue[k]);
    }
    return R(2.0) * n->scale * (high - low);
}

HYSTMPC_LOCAL void hystmpc_learning_advance(const hystmpc_learner *n, real *past, real u) {
    const real x = hystmpc_share_of_range(&n->basis, u);
    real *history = past + LEARN_HISTORY;
    for (int t = LEARN_DELAYS + n->delay; t > 0; t--)
        for (int i = 0; i < LEARN_INSTANT; i++) history[t * LEARN_INSTANT + i] = history[(t - 1) * LEARN_INSTANT + i];
    hystmpc_advance_memory(&n->basis, history, LEARN_LAGS, x, n->lags);
    hystmpc_advance_queue(past + LEARN_QUEUE, x);
}

/* One measurement for all lags of a delay. Of each covariance the lower triangle is stored, row by row. `still`: the
 * command rests; no weight can have changed then, and a large error is a jump of the offset. */
static void correct_drives(const hystmpc_learner *n, real (*restrict z)[HYSTMPC_LAGS], real (*restrict p)[HYSTMPC_LAGS],
                           real (*restrict h)[HYSTMPC_LAGS], const real *error, int still) {
    real spread[HYSTMPC_UNKNOWNS][HYSTMPC_LAGS], variance[HYSTMPC_LAGS], shrunk[HYSTMPC_LAGS];
    int usable[HYSTMPC_LAGS];
    for (int a = 0, at = 0; a < LEARN_UNKNOWNS; a++, at++) {
        real own[HYSTMPC_LAGS] = {R(0.0)};
        for (int b = 0; b < a; b++, at++) {
            for (int i = 0; i < LEARN_LAGS; i++) {
                own[i] += p[at][i] * h[b][i];
                spread[b][i] += p[at][i] * h[a][i];
            }
        }
        for (int i = 0; i < LEARN_LAGS; i++) spread[a][i] = own[i] + p[at][i] * h[a][i];
    }
    for (int i = 0; i < LEARN_LAGS; i++) variance[i] = n->noise;
    for (int a = 0; a < LEARN_UNKNOWNS; a++)
        for (int i = 0; i < LEARN_LAGS; i++) variance[i] += h[a][i] * spread[a][i];
    for (int i = 0; i < LEARN_LAGS; i++) {
        const real square = error[i] * error[i];
        usable[i] = n->noise <= variance[i] && is_finite(variance[i]) && is_finite(error[i]);
        const real jump = still && square > LEARN_SURPRISE * variance[i] ? square : R(0.0);
        p[0][i] += jump;
        spread[0][i] += jump;
        shrunk[i] = R(1.0) / MATH(sqrt)(variance[i] + jump);
    }
    for (int a = 0, at = 0; a < LEARN_UNKNOWNS; a++) {
        for (int i = 0; i < LEARN_LAGS; i++) {
            spread[a][i] *= shrunk[i]; /* twice the same factor: the covariance stays symmetric to the last bit */
            z[a][i] = usable[i] ? z[a][i] + spread[a][i] * (shrunk[i] * error[i]) : z[a][i];
        }
        for (int b = 0; b <= a; b++, at++)
            for (int i = 0; i < LEARN_LAGS; i++) p[at][i] -= spread[a][i] * spread[b][i];
    }
    for (int i = 0; i < LEARN_LAGS; i++)
        if (!usable[i]) start_covariance(n, p, i); /* rounding has eaten the covariance */
}

/* Mean square of what a forecast misses, without the noise of the measurements [deg^2]. */
static real missed(const hystmpc_learner *n, real score) { return most(score - n->expected, R(0.0)) + n->floor; }

/* Whether anything had been learned when a block of forecasts began. */
static int has_learned(const hystmpc_filters *l) {
    for (int a = 1; a < LEARN_UNKNOWNS; a++)
        if (l->frozen[0][a][0] != R(0.0)) return 1;
    return 0;
}

/* What a block of forecasts says: the scores, the drive that is used, how far it acts. Forecasts from before anything
 * was learned are the model's: its error at the start is in all scores, and would hide for long who foretells better. */
static void judge(const hystmpc_learner *n, hystmpc_filters *l, const real *means) {
    if (means[LEARN_LAST_ANGLE] <= LEARN_MOVING * n->noise || !has_learned(l)) return;
    const real before = (real)l->blocks + LEARN_ALIKE, kept = least(n->kept, before / (before + R(1.0)));
    int first = 0;
    if (l->blocks == 0)
        for (int i = 0; i < LEARN_DRIVES + 2; i++) l->scores[i] = n->noise;
    for (int i = 0; i < LEARN_DRIVES + 2; i++) l->scores[i] = kept * l->scores[i] + (R(1.0) - kept) * means[i];
    for (int i = 1; i < LEARN_DRIVES; i++)
        if (l->scores[i] < l->scores[first]) first = i;
    if (l->scores[first] < LEARN_BETTER * l->scores[l->best]) l->best = first;
    const real gained = R(1.0) - missed(n, l->scores[l->best]) / missed(n, l->scores[LEARN_MODEL_ALONE]);
    const real off = MATH(sqrt)(least(means[LEARN_MODEL_ALONE], means[l->best]) / means[LEARN_LAST_ANGLE]);
    l->forecast_error = LEARN_RECENT * l->forecast_error + (R(1.0) - LEARN_RECENT) * least(off, LEARN_WORST);
    l->blocks++;
    l->share = clamp((gained - n->gain) / LEARN_FULL_GAIN, R(0.0), R(1.0));
}

/* Way of the command in the sample that led to the measured angle, as a share of the range. */
static real learning_travel(const hystmpc_learner *n, const real *past) {
    const real *now = past + LEARN_HISTORY + n->delay * LEARN_INSTANT;
    return absolute(now[0] - now[LEARN_INSTANT]);
}

HYSTMPC_LOCAL void hystmpc_learning_wait(const hystmpc_learner *n, const real *past, hystmpc_filters *l) {
    l->waited += R(1.0);
    l->travelled += learning_travel(n, past);
}

/* Every drive with a measurement used, and the errors of its forecast added. */
static void correct_all(const hystmpc_learner *n, const real *past, hystmpc_filters *l, real y, real angle) {
    const real *now = past + LEARN_HISTORY + n->delay * LEARN_INSTANT;
    const real travel = learning_travel(n, past) + l->travelled, samples = R(1.0) + l->waited;
    for (int delay = 0; delay < LEARN_DELAYS; delay++, now += LEARN_INSTANT) {
        real(*z)[HYSTMPC_LAGS] = l->z[delay], (*p)[HYSTMPC_LAGS] = l->covariance[delay];
        real h[HYSTMPC_UNKNOWNS][HYSTMPC_LAGS], error[HYSTMPC_LAGS], forecast[HYSTMPC_LAGS];
        hystmpc_features(&n->basis, now, now + LEARN_INSTANT, LEARN_LAGS, past[0], past[1], h[2]);
        for (int i = 0; i < LEARN_LAGS; i++) {
            h[0][i] = R(1.0);
            h[1][i] = angle - past[2];
            error[i] = forecast[i] = y - angle;
        }
        for (int a = 0; a < LEARN_UNKNOWNS; a++) {
            for (int i = 0; i < LEARN_LAGS; i++) {
                error[i] -= h[a][i] * z[a][i];
                forecast[i] -= h[a][i] * l->frozen[delay][a][i];
            }
        }
        for (int lag = 0; lag < LEARN_LAGS; lag++) l->sums[lag * LEARN_DELAYS + delay] += forecast[lag] * forecast[lag];
        correct_drives(n, z, p, h, error, travel == R(0.0));
        for (int a = 0; a < LEARN_UNKNOWNS; a++) {
            real *own = p[a * (a + 3) / 2];
            for (int i = 0; i < LEARN_LAGS; i++) {
                const real grown = own[i] + n->growth[a] * samples + n->walk[a] * travel;
                own[i] = least(grown, most(n->prior[a], own[i]));
            }
        }
    }
}

HYSTMPC_LOCAL void hystmpc_learning_correct(const hystmpc_learner *n, const real *past, hystmpc_filters *l, real y,
                                            real angle, real disturbance) {
    correct_all(n, past, l, y, angle);
    const real own = y - angle - l->references[0], none = y - l->references[1];
    l->sums[LEARN_MODEL_ALONE] += own * own;
    l->sums[LEARN_LAST_ANGLE] += none * none;
    l->waited = l->travelled = R(0.0);
    l->count++;
    if (l->count < n->block) return;
    real means[HYSTMPC_DRIVES + 2];
    for (int i = 0; i < LEARN_DRIVES + 2; i++) means[i] = l->sums[i] / (real)l->count;
    judge(n, l, means);
    for (int i = 0; i < LEARN_DRIVES + 2; i++) l->sums[i] = R(0.0);
    l->count = 0;
    freeze(l);
    l->references[0] = disturbance;
    l->references[1] = y;
}

/* The memory behind one lag, so many samples ago. */
static void memory_behind(const real *past, int at, int lag, real *memory) {
    for (int i = 0; i < HYSTMPC_MEMORY; i++) memory[i] = past[LEARN_HISTORY + at * LEARN_INSTANT + i * LEARN_LAGS + lag];
}

/* The share with which the best drive acts: at most the one with which the way to each end of the range still moves the
 * angle by LEARN_ANSWER of what the model's mean slope says. Where a device has stood still, filters learn that it does
 * not answer; a plan on such a model would never move again, and nothing would be learned that corrects it. */
static real acting_share(const hystmpc_learner *n, const real *past, const hystmpc_filters *l) {
    const int lag = l->best / LEARN_DELAYS, delay = l->best % LEARN_DELAYS;
    real memory[HYSTMPC_MEMORY], far[HYSTMPC_MEMORY], f[HYSTMPC_FEATURES], g[HYSTMPC_FEATURES], share = l->share;
    if (share == R(0.0)) return share;
    memory_behind(past, delay, lag, memory);
    hystmpc_features(&n->basis, memory, memory, 1, past[0], past[1], f);
    for (int end = 0; end <= 1; end++) {
        const real way = (real)end - memory[0], moves = n->scale * way;
        if (absolute(way) < LEARN_FAR || moves == R(0.0)) continue;
        for (int i = 0; i < HYSTMPC_MEMORY; i++) far[i] = memory[i];
        far[0] = (real)end;
        for (int i = 0; i < HYSTMPC_PLAYS; i++)
            far[1 + i] = clamp(far[1 + i], far[0] - hystmpc_radii[i], far[0] + hystmpc_radii[i]);
        hystmpc_features(&n->basis, far, far, 1, past[0], past[1], g);
        real change = l->z[delay][1][lag] * moves;
        for (int i = 0; i < HYSTMPC_FEATURES; i++) change += l->z[delay][2 + i][lag] * (g[i] - f[i]);
        const real taken = -change / moves;
        if (share * taken > R(1.0) - LEARN_ANSWER) share = (R(1.0) - LEARN_ANSWER) / taken;
    }
    return share;
}

HYSTMPC_LOCAL void hystmpc_learning_added(const hystmpc_learner *n, const real *past, const hystmpc_filters *l,
                                          const real *angles, real *added) {
    const int lag = l->best / LEARN_DELAYS, delay = l->best % LEARN_DELAYS;
    const real share = acting_share(n, past, l);
    real memory[HYSTMPC_MEMORY], f[HYSTMPC_FEATURES];
    for (int k = 0; k <= n->delay; k++) {
        const int at = delay + n->delay - k;
        if (share == R(0.0)) {
            added[k] = R(0.0);
            continue;
        }
        memory_behind(past, at, lag, memory);
        const real *const before = past + LEARN_HISTORY + (at + 1) * LEARN_INSTANT + lag;
        hystmpc_features(&n->basis, memory, before, 1, past[0], past[1], f);
        real total = l->z[delay][1][lag] * (angles[k] - past[2]);
        for (int i = 0; i < HYSTMPC_FEATURES; i++) total += l->z[delay][2 + i][lag] * f[i];
        added[k] = share * total;
    }
}

HYSTMPC_LOCAL void hystmpc_learning_state(const hystmpc_learner *n, const real *past, const hystmpc_filters *l,
                                          hystmpc_learned *s) {
    const int lag = l->best / LEARN_DELAYS, delay = l->best % LEARN_DELAYS;
    const real share = acting_share(n, past, l);
    memory_behind(past, delay, lag, s->memory);
    for (int k = 0; k < LEARN_DELAYS; k++) s->queue[k] = past[LEARN_QUEUE + k];
    for (int i = 0; i < HYSTMPC_WEIGHTS; i++) s->weights[i] = share * l->z[delay][1 + i][lag];
    for (int i = 0; i < 3; i++) s->start[i] = past[i];
    s->share = n->lags[lag];
    s->delay = (real)delay;
}

#undef LEARN_BETTER
#undef LEARN_FULL_GAIN
#undef LEARN_ALIKE
#undef LEARN_MOVING
#undef LEARN_RECENT
#undef LEARN_WORST
#undef LEARN_ANSWER
#undef LEARN_FAR
#undef LEARN_SURPRISE
