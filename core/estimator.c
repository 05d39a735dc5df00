/* A bank of Kalman filters of one disturbance d, weighted by their likelihoods (Magill, "Optimal adaptive estimation of
 * sampled stochastic processes", IEEE Transactions on Automatic Control 10, 1965):
 *
 *     S_i = P_i + sensor_i^2,   K_i = min(P_i / S_i, most),   d_i <- d_i + K_i (z - d_i)
 *     P_i <- (1 - K_i)^2 P_i + K_i^2 sensor_i^2,   w_i <- w_i p(z - d_i; S_i) / sum_j w_j p(z - d_j; S_j)
 *     d = sum_i w_i d_i,   P = sum_i w_i (P_i + (d_i - d)^2)
 *
 * p is Student's density with 7 degrees of freedom: one outlier says little. */
#include "estimator.h"

#define BANK_BY_FREEDOM R(0.2)   /* 1 / (7 - 2) */
#define BANK_SENSOR_SHARE R(0.2) /* of the changes of the model's error are changes of the sensor too */
#if HYSTMPC_SINGLE
#define BANK_LEAST_WEIGHT R(1e-30)
#else
#define BANK_LEAST_WEIGHT R(1e-300)
#endif

/* total = sum of a term by i in eight parts, every eighth term in one: the same order for every width of vectors. */
#define BANK_SUM(total, count, term)                                      \
    {                                                                         \
        real part[8] = {R(0.0)};                                              \
        const int whole = (count) - (count) % 8;                              \
        for (int start = 0; start < whole; start += 8)                        \
            for (int i = start; i < start + 8; i++) part[i - start] += (term); \
        total = (part[0] + part[4]) + (part[2] + part[6]);                    \
        total += (part[1] + part[5]) + (part[3] + part[7]);                   \
        for (int i = whole; i < (count); i++) total += (term);                \
    }

static int bank_models(const hystmpc_noise *n) { return n->drifts * n->motions; }

/* Of them, those of a model that is not close; they stand first. */
static int bank_far(const hystmpc_noise *n) { return (n->drifts - n->close) * n->motions; }

/* Variance of the mixture of all filters about its mean. */
static real mixed_variance(const real *bank, int count, real mean) {
    const real *d = bank, *p = bank + count, *w = p + count;
    real total;
    BANK_SUM(total, count, w[i] * (p[i] + (d[i] - mean) * (d[i] - mean)))
    return total;
}

static void prior_weights(const hystmpc_noise *n, real *w) {
    const int models = bank_models(n);
    for (int j = 0; j < n->sensors; j++)
        for (int i = 0; i < models; i++) w[j * models + i] = n->by_sensor[j] * n->by_model[i];
}

HYSTMPC_LOCAL real hystmpc_noise_init(const hystmpc_noise *n, real *bank, real disturbance) {
    const int models = bank_models(n), count = n->sensors * models, far = bank_far(n);
    real *d = bank, *p = bank + count, *w = p + count, total;
    prior_weights(n, w);
    for (int i = 0; i < count; i++) {
        d[i] = i % models < far ? disturbance : R(0.0);
        p[i] = n->first_variances[i % models];
    }
    BANK_SUM(total, count, w[i] * p[i])
    return total;
}

/* Every filter of one sensor with a measurement used, its weight by how well it foretold it. */
static void correct_filters(const hystmpc_noise *n, real *restrict d, real *restrict p, real *restrict w, int count,
                            real noise, real offset) {
    const real most_gain = n->most_gain, limit = n->limit;
    for (int i = 0; i < count; i++) {
        const real before = p[i], spread = before + noise, error = offset - d[i];
        const real by_spread = R(1.0) / spread;
        real odd = R(1.0) + error * error * by_spread * BANK_BY_FREEDOM;
        odd *= odd;
        const real gain = least(before * by_spread, most_gain), rest = R(1.0) - gain;
        d[i] = clamp(d[i] + gain * error, -limit, limit);
        p[i] = rest * rest * before + gain * gain * noise;
        w[i] = w[i] / (MATH(sqrt)(spread) * odd * odd);
    }
}

/* Weights mixed with their prior, since how wrong the model is may have changed (a jump Markov model: Blom and Bar-Shalom,
 * IEEE Transactions on Automatic Control 33, 1988, without their mixing of the filters). */
static void mix_weights(const hystmpc_noise *n, real *w) {
    const int models = bank_models(n);
    for (int j = 0; j < n->sensors; j++) {
        real *own = w + j * models, share;
        BANK_SUM(share, models, own[i])
        share = n->switching * ((R(1.0) - BANK_SENSOR_SHARE) * share + BANK_SENSOR_SHARE * n->by_sensor[j]);
        for (int i = 0; i < models; i++) own[i] = (R(1.0) - n->switching) * own[i] + share * n->by_model[i];
    }
}

HYSTMPC_LOCAL real hystmpc_noise_correct(const hystmpc_noise *n, real *bank, real offset, real *mean) {
    const int models = bank_models(n), count = n->sensors * models;
    real *d = bank, *p = bank + count, *w = p + count, total, off;
    mix_weights(n, w);
    for (int j = 0, at = 0; j < n->sensors; j++, at += models)
        correct_filters(n, d + at, p + at, w + at, models, n->sensor_variances[j], offset);
    BANK_SUM(total, count, w[i])
    if (!(total > BANK_LEAST_WEIGHT)) { /* none has foretold it at all: as before anything was seen */
        prior_weights(n, w);
        BANK_SUM(total, count, w[i])
    }
    total = R(1.0) / total;
    for (int i = 0; i < count; i++) w[i] *= total;
    BANK_SUM(off, count, w[i] * (d[i] - d[0]))
    *mean = d[0] + off;
    return mixed_variance(bank, count, *mean);
}

/* d <- f d, P <- f^2 (P + q), f^2 = 1 / (1 + q / s^2), q the variance of the step and s^2 the greatest one: a walk that
 * returns to zero, of variance s^2 at any time. */
HYSTMPC_LOCAL real hystmpc_noise_advance(const hystmpc_noise *n, real *bank, real travel, real mean) {
    enum { ABREAST = 8 };
    const int models = bank_models(n), count = n->sensors * models;
    for (int first = 0; first < models; first += ABREAST) { /* the factors are those of every sensor */
        const int width = models - first < ABREAST ? models - first : ABREAST;
        real step[ABREAST], squared[ABREAST], root[ABREAST];
        for (int i = 0; i < width; i++) {
            step[i] = n->drift_variances[first + i] + n->motion_variances[first + i] * travel;
            squared[i] = R(1.0) / (R(1.0) + step[i] / n->most_variances[first + i]);
            root[i] = MATH(sqrt)(squared[i]);
        }
        for (real *d = bank + first; d < bank + count; d += models) {
            real *restrict const p = d + count;
            for (int i = 0; i < width; i++) {
                d[i] *= root[i];
                p[i] = squared[i] * (p[i] + step[i]);
            }
        }
    }
    return mixed_variance(bank, count, mean);
}

HYSTMPC_LOCAL real hystmpc_noise_close(const hystmpc_noise *n, const real *bank) {
    const int models = bank_models(n), far = bank_far(n);
    const real *w = bank + 2 * n->sensors * models;
    real total = R(0.0);
    for (int j = 0; j < n->sensors; j++)
        for (int i = far; i < models; i++) total += w[j * models + i];
    return total;
}

HYSTMPC_LOCAL real hystmpc_noise_mean(const hystmpc_noise *n, const real *bank) {
    const int count = n->sensors * bank_models(n);
    const real *d = bank, *w = bank + 2 * count;
    real total;
    BANK_SUM(total, count, w[i] * d[i])
    return total;
}

HYSTMPC_LOCAL real hystmpc_noise_sensor(const hystmpc_noise *n, const real *bank, const real *logs) {
    const int count = n->sensors * bank_models(n);
    const real *w = bank + 2 * count;
    real total;
    BANK_SUM(total, count, w[i] * logs[i])
    return MATH(exp)(total);
}

#undef BANK_BY_FREEDOM
#undef BANK_SENSOR_SHARE
#undef BANK_LEAST_WEIGHT
#undef BANK_SUM
