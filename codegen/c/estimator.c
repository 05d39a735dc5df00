/* Model state from the commands really sent, output disturbance from the measurements. */
#include "internal.h"

/* One sample more; a count stays where it is before it runs over. */
HYSTMPC_LOCAL int later(int samples) { return samples < HYSTMPC_MOST_SAMPLES ? samples + 1 : samples; }

/* The measured angle, or not-a-number where it is missing or absurdly large. */
HYSTMPC_LOCAL real usable_angle(real y) { return absolute(y) <= HYSTMPC_ANGLE_BOUND ? y : (real)NAN; }

/* One sample of the model; 0 where its answer is not finite or absurdly large. */
static int model_advance(const real *x, real u, real *angle, real *next) {
    real sum = R(0.0);
    model_step(x, u, angle, next);
    for (int i = 0; i < S; i++) sum += next[i];
    return absolute(*angle) <= HYSTMPC_ANGLE_BOUND && finite(sum);
}

#if HYSTMPC_SENSES

enum { M = HYSTMPC_FILTERS, SENSORS = HYSTMPC_SENSORS, DRIFTS = HYSTMPC_DRIFTS, MOTIONS = HYSTMPC_MOTIONS };

/* Variances of the grid's noises, and how likely each was before anything was seen. */
static const real sensor_variance[HYSTMPC_SENSORS] = HYSTMPC_SENSOR_VARIANCES;
static const real drift_variance[HYSTMPC_DRIFTS] = HYSTMPC_DRIFT_VARIANCES;    /* of a walk in a sample */
static const real motion_variance[HYSTMPC_MOTIONS] = HYSTMPC_MOTION_VARIANCES; /* over one unit of travel */
static const real by_sensor[HYSTMPC_SENSORS] = HYSTMPC_BY_SENSOR;
static const real by_model[HYSTMPC_DRIFTS * HYSTMPC_MOTIONS] = HYSTMPC_BY_MODEL;

/* total = sum of a term by i in eight parts, every eighth term in one, as Python adds. */
#define SUM_IN_PARTS(total, count, term)                                  \
    {                                                                     \
        real part[8] = {R(0.0)};                                          \
        const int whole = (count) - (count) % 8;                          \
        for (int first = 0; first < whole; first += 8)                    \
            for (int i = first; i < first + 8; i++) part[i - first] += (term); \
        total = (part[0] + part[4]) + (part[2] + part[6]);                \
        total += (part[1] + part[5]) + (part[3] + part[7]);               \
        for (int i = whole; i < (count); i++) total += (term);            \
    }

/* Variance of the mixture of all filters about its mean. */
static real mixed_variance(real bank[3][HYSTMPC_FILTERS], real mean) {
    real total;
    SUM_IN_PARTS(total, M, bank[2][i] * (bank[1][i] + (bank[0][i] - mean) * (bank[0][i] - mean)))
    return total;
}

static void prior_weights(real *weights) {
    for (int i = 0; i < M; i++) weights[i] = by_sensor[i / (DRIFTS * MOTIONS)] * by_model[i % (DRIFTS * MOTIONS)];
}

static void bank_init(hystmpc_estimate *e, real disturbance) {
    real total = R(0.0);
    prior_weights(e->bank[2]);
    for (int i = 0; i < M; i++) {
        e->bank[0][i] = disturbance;
        e->bank[1][i] = HYSTMPC_FIRST_VARIANCE;
        total += e->bank[2][i] * HYSTMPC_FIRST_VARIANCE;
    }
    e->variance = total;
}

/* Every filter with a measurement used, its weight by how well it foretold it (Student's density, 7 degrees of freedom);
 * then all weights mixed with their prior, since how wrong the model is may change. */
HYSTMPC_LOCAL void bank_correct(real bank[3][HYSTMPC_FILTERS], real offset, real *mean, real *variance) {
    enum { INNER = DRIFTS * MOTIONS };
    real total, off;
    for (int j = 0; j < SENSORS; j++) {
        const real noise = sensor_variance[j];
        for (int i = j * INNER; i < (j + 1) * INNER; i++) {
            const real before = bank[1][i], spread = before + noise, error = offset - bank[0][i];
            const real by_spread = R(1.0) / spread;
            real odd = R(1.0) + error * error * by_spread * R(0.2);
            odd *= odd;
            const real gain = least(before * by_spread, HYSTMPC_MOST_GAIN), rest = R(1.0) - gain;
            bank[0][i] = clamp(bank[0][i] + gain * error, -HYSTMPC_DISTURBANCE_LIMIT, HYSTMPC_DISTURBANCE_LIMIT);
            bank[1][i] = rest * rest * before + gain * gain * noise;
            bank[2][i] = bank[2][i] / (root(spread) * odd * odd);
        }
    }
    SUM_IN_PARTS(total, M, bank[2][i])
    if (!(total > HYSTMPC_LEAST_WEIGHT)) { /* none has foretold it at all: as before anything was seen */
        prior_weights(bank[2]);
        SUM_IN_PARTS(total, M, bank[2][i])
    }
    const real kept = (R(1.0) - HYSTMPC_SWITCHING) / total;
    for (int j = 0; j < SENSORS; j++) {
        real share;
        SUM_IN_PARTS(share, INNER, bank[2][j * INNER + i])
        share = HYSTMPC_SWITCHING *
                ((R(1.0) - HYSTMPC_SENSOR_SHARE) * share / total + HYSTMPC_SENSOR_SHARE * by_sensor[j]);
        for (int i = 0; i < INNER; i++) {
            const int k = j * INNER + i;
            bank[2][k] = kept * bank[2][k] + share * by_model[i];
        }
    }
    SUM_IN_PARTS(off, M, bank[2][i] * (bank[0][i] - bank[0][0]))
    *mean = bank[0][0] + off;
    *variance = mixed_variance(bank, *mean);
}

/* One sample later; the variance about `mean`. */
HYSTMPC_LOCAL real bank_advance(real bank[3][HYSTMPC_FILTERS], real travel, real mean) {
    for (int j = 0; j < SENSORS * DRIFTS; j++) {
        real *variance = bank[1] + j * MOTIONS;
        for (int i = 0; i < MOTIONS; i++) {
            const real grown = variance[i] + drift_variance[j % DRIFTS] + motion_variance[i] * travel;
            variance[i] = least(grown, HYSTMPC_DISTURBANCE_LIMIT * HYSTMPC_DISTURBANCE_LIMIT);
        }
    }
    return mixed_variance(bank, mean);
}

#endif

/* At rest: what the model cannot explain of y is the first disturbance. */
HYSTMPC_LOCAL int estimate_init(hystmpc_estimate *e, real y, real u) {
    real x[HYSTMPC_STATES], next[HYSTMPC_STATES], angle;
    if (!finite(usable_angle(y))) return HYSTMPC_BAD_ANGLE;
    if (!(HYSTMPC_LOWER <= u && u <= HYSTMPC_UPPER)) return HYSTMPC_BAD_COMMAND;
    hystmpc_rest(y, u, x);
    if (!model_advance(x, u, &angle, next)) return HYSTMPC_NOT_AT_REST;
    if (!(absolute(y - angle) <= HYSTMPC_REST_TOLERANCE)) return HYSTMPC_NOT_AT_REST;
    copy(next, e->model, S); /* nothing is written before the start is accepted */
    e->started = HYSTMPC_MARK;
    e->command = u;
    for (int k = 0; k < HYSTMPC_UNDER_WAY; k++) {
        e->angles[k] = angle;
        e->responsive[k] = 1;
        e->moves[k] = R(0.0);
    }
    e->missing = e->stalled = 0;
#if HYSTMPC_SENSES
    e->disturbance = y - angle;
    e->measured = y;
    bank_init(e, e->disturbance);
#else
    e->disturbance = e->variance = R(0.0);
    e->measured = angle;
#endif
    return HYSTMPC_STARTED;
}

/* Use measurement y; 0 where it is none or an outlier. */
HYSTMPC_LOCAL int estimate_correct(hystmpc_estimate *e, real y) {
#if HYSTMPC_SENSES
    const real angle = usable_angle(y), offset = angle - e->angles[0];
    if (!(absolute(offset - e->disturbance) <= HYSTMPC_OUTLIER || absolute(angle - e->measured) <= HYSTMPC_OUTLIER)) {
        e->missing = later(e->missing);
        return 0;
    }
    e->measured = y;
    e->missing = 0;
    if (e->responsive[0]) bank_correct(e->bank, offset, &e->disturbance, &e->variance);
#else
    (void)y;
    e->measured = e->angles[0];
#endif
    return 1;
}

/* One sample later, u having been sent; where the model fails its state stands still. */
HYSTMPC_LOCAL int estimate_advance(hystmpc_estimate *e, real u) {
    real next[HYSTMPC_STATES], angle;
    const real moved = absolute(u - e->command), before = e->angles[HYSTMPC_DELAY];
    const int advanced = model_advance(e->model, u, &angle, next);
    if (advanced) copy(next, e->model, S);
    else angle = before;
    e->stalled = advanced ? 0 : later(e->stalled);
    for (int k = 0; k < HYSTMPC_DELAY; k++) {
        e->angles[k] = e->angles[k + 1];
        e->responsive[k] = e->responsive[k + 1];
        e->moves[k] = e->moves[k + 1];
    }
    e->angles[HYSTMPC_DELAY] = angle;
#if HYSTMPC_SENSES
    e->responsive[HYSTMPC_DELAY] =
        absolute(angle - before) >= HYSTMPC_DEAD_BAND_GAIN * moved || moved <= HYSTMPC_RESOLUTION;
#endif
    e->moves[HYSTMPC_DELAY] = moved;
    e->command = u;
#if HYSTMPC_SENSES
    e->variance = bank_advance(e->bank, e->moves[0], e->disturbance);
#endif
    return advanced;
}
