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
    return absolute(*angle) <= HYSTMPC_ANGLE_BOUND && is_finite(sum);
}

/* At rest: what the model cannot explain of y is the first disturbance. */
HYSTMPC_LOCAL int estimate_init(hystmpc_estimate *e, real y, real u) {
    real x[HYSTMPC_STATES], next[HYSTMPC_STATES], angle;
    if (!is_finite(usable_angle(y))) return HYSTMPC_BAD_ANGLE;
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
    e->variance = hystmpc_noise_init(&hystmpc_noises, e->bank[0], e->disturbance);
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
    if (e->responsive[0])
        e->variance = hystmpc_noise_correct(&hystmpc_noises, e->bank[0], offset, &e->disturbance);
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
    e->variance = hystmpc_noise_advance(&hystmpc_noises, e->bank[0], e->moves[0], e->disturbance);
#endif
    return advanced;
}
