/* An estimate from rest, corrected and advanced sample by sample, with a sensor or without, with a learned part or without;
 * the filters of its disturbance are in estimator.c, those of the learned part in learning.c. */
#include "estimates.h"

#include <string.h>

static long observer_rounded(long bytes, long unit) { return (bytes + unit - 1) / unit * unit; }

static long observer_row(int numbers) { return observer_rounded((long)numbers * (long)sizeof(real), 8); }

static int observer_newest(const hystmpc_sensing *s) {
    return s->sensor == HYSTMPC_NEWEST || s->sensor == HYSTMPC_NEWEST_FRAME;
}

static int observer_learns(const hystmpc_sensing *s, const hystmpc_model *m) {
    return (s->sensor == HYSTMPC_CONTINUOUS || s->sensor == HYSTMPC_FRAMES) && m && m->learner;
}

/* Whether the observer advances a model by itself. */
static int observer_has_model(const hystmpc_sensing *s, const hystmpc_model *m) {
    return !observer_newest(s) && m && m->predictor;
}

HYSTMPC_LOCAL int hystmpc_later(int samples) { return samples < HYSTMPC_MOST_SAMPLES ? samples + 1 : samples; }

HYSTMPC_LOCAL real hystmpc_usable_angle(real y) { return absolute(y) <= HYSTMPC_ANGLE_BOUND ? y : (real)NAN; }

HYSTMPC_LOCAL int hystmpc_numbers_past(const hystmpc_learner *n) {
    return 3 + HYSTMPC_DELAYS + (HYSTMPC_DELAYS + 1 + n->delay) * HYSTMPC_MEMORY * HYSTMPC_LAGS;
}

HYSTMPC_LOCAL hystmpc_extent hystmpc_extent_of(const hystmpc_sensing *s, const hystmpc_model *m) {
    hystmpc_extent n = {0, 0, 0, 0};
    if (observer_newest(s)) return n;
    if (m && m->predictor) n.states = m->predictor->states;
    n.angles = s->delay + 1;
    if (s->noise) n.bank = 3 * s->noise->sensors * s->noise->drifts * s->noise->motions;
    if (s->sensor == HYSTMPC_FRAMES && observer_learns(s, m)) n.alone = n.angles;
    return n;
}

HYSTMPC_LOCAL long hystmpc_estimate_bytes(const hystmpc_extent *n) {
    return observer_rounded((long)sizeof(hystmpc_known), 8) + observer_row(n->states) + 3 * observer_row(n->angles) +
           observer_row(n->bank) + observer_row(n->alone);
}

/* So many numbers of a block, which goes on behind them. */
static real *observer_take(char **at, int numbers) {
    real *here = (real *)(void *)*at;
    *at += observer_row(numbers);
    return here;
}

HYSTMPC_LOCAL hystmpc_estimate hystmpc_estimate_at(const hystmpc_extent *n, char *block) {
    hystmpc_estimate e;
    e.known = (hystmpc_known *)(void *)block;
    block += observer_rounded((long)sizeof(hystmpc_known), 8);
    e.model = observer_take(&block, n->states);
    e.angles = observer_take(&block, n->angles);
    e.responsive = observer_take(&block, n->angles);
    e.moves = observer_take(&block, n->angles);
    e.bank = observer_take(&block, n->bank);
    e.alone = observer_take(&block, n->alone);
    return e;
}

HYSTMPC_LOCAL long hystmpc_observed_bytes(const hystmpc_sensing *s, const hystmpc_model *m) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const long block = hystmpc_estimate_bytes(&n);
    long bytes = block;
    if (observer_learns(s, m)) {
        const long past = observer_row(hystmpc_numbers_past(m->learner));
        bytes += observer_rounded((long)sizeof(hystmpc_filters), 8) + past + observer_row(n.angles);
        bytes += n.alone ? past : block;
    }
    if (s->sensor == HYSTMPC_FRAMES) bytes += (long)s->oldest * block + 8;
    return bytes;
}

HYSTMPC_LOCAL void hystmpc_observed_at(const hystmpc_sensing *s, const hystmpc_model *m, char *memory,
                                       hystmpc_observed *o) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const long block = hystmpc_estimate_bytes(&n);
    memset(o, 0, sizeof *o);
    o->now = hystmpc_estimate_at(&n, memory);
    memory += block;
    if (observer_learns(s, m)) {
        o->alone = n.alone ? o->now : hystmpc_estimate_at(&n, memory);
        if (n.alone) o->alone.angles = o->now.alone;
        else memory += block;
        o->learning.filters = (hystmpc_filters *)(void *)memory;
        memory += observer_rounded((long)sizeof(hystmpc_filters), 8);
        o->learning.past = observer_take(&memory, hystmpc_numbers_past(m->learner));
        o->learning.added = observer_take(&memory, n.angles);
        if (n.alone) o->learning.behind = observer_take(&memory, hystmpc_numbers_past(m->learner));
    }
    if (s->sensor == HYSTMPC_FRAMES) {
        o->past = memory;
        o->instants = (int *)(void *)(memory + (long)s->oldest * block);
    }
}

static long observer_predictor_room(const hystmpc_model *m) {
    return m && m->predictor ? observer_rounded(hystmpc_predictor_bytes(m->predictor, 1, 1), 64) : 0;
}

HYSTMPC_LOCAL long hystmpc_observer_bytes(const hystmpc_sensing *s, const hystmpc_model *m) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const long work = n.alone ? observer_row(hystmpc_numbers_past(m->learner)) : 0;
    return observer_predictor_room(m) + observer_row(n.states) + observer_row(n.angles) + work;
}

HYSTMPC_LOCAL real *hystmpc_observer_work(const hystmpc_model *m, char *room) {
    return (real *)(void *)(room + observer_predictor_room(m));
}

HYSTMPC_LOCAL int hystmpc_next_of_model(const hystmpc_model *m, const real *x, real u, real *next, real *angle,
                                        char *room) {
    const int states = m->predictor->states;
    real sum = R(0.0);
    if (states) memcpy(next, x, sizeof(real) * (size_t)states);
    if (hystmpc_predictor_advance(m->predictor, next, u, angle, room) != 0) return 0;
    for (int i = 0; i < states; i++) sum += next[i];
    return absolute(*angle) <= HYSTMPC_ANGLE_BOUND && is_finite(sum);
}

/* Rest at y under u, the state (S) and the model's angle given; what the model cannot explain of y is the first
 * disturbance. With few and noisy frames the model counts as right at first. */
static void observer_start(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e, const real *x,
                           real angle, real y, real u) {
    memset(e->known, 0, sizeof *e->known);
    e->known->command = u;
    e->known->measured = s->sensor == HYSTMPC_NO_SENSOR ? angle : y;
    if (s->sensor == HYSTMPC_CONTINUOUS) e->known->disturbance = y - angle;
    if (n->states) memcpy(e->model, x, sizeof(real) * (size_t)n->states);
    for (int k = 0; k < n->angles; k++) {
        e->angles[k] = angle;
        e->responsive[k] = R(1.0);
        e->moves[k] = R(0.0);
    }
    if (n->bank) e->known->variance = hystmpc_noise_init(s->noise, e->bank, e->known->disturbance);
}

/* The whole's angles from those of the model alone and what is learned. */
static void observer_put_together(const hystmpc_model *m, const hystmpc_extent *n, hystmpc_observed *o) {
    const hystmpc_learning *l = &o->learning;
    hystmpc_learning_added(m->learner, l->past, l->filters, o->alone.angles, l->added);
    for (int k = 0; k < n->angles; k++) {
        o->now.angles[k] = o->alone.angles[k] + l->added[k];
        o->now.responsive[k] = o->alone.responsive[k];
        o->now.moves[k] = o->alone.moves[k];
    }
    o->now.known->added = l->added[0];
    o->now.known->forecast_error = l->filters->forecast_error;
}

HYSTMPC_LOCAL int hystmpc_observer_init(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                        const real *x, real y, real u, char *room) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    real angle = y;
    if (!is_finite(hystmpc_usable_angle(y))) return HYSTMPC_BAD_ANGLE;
    if (!is_finite(u)) return HYSTMPC_BAD_COMMAND;
    if (observer_has_model(s, m)) { /* one sample later, at rest */
        real *next = hystmpc_observer_work(m, room);
        if (!hystmpc_next_of_model(m, x, u, next, &angle, room)) return HYSTMPC_NOT_AT_REST;
        if (!(absolute(y - angle) <= s->rest_tolerance)) return HYSTMPC_NOT_AT_REST;
        x = next;
    }
    observer_start(s, &n, &o->now, x, angle, y, u);
    if (observer_learns(s, m)) {
        observer_start(s, &n, &o->alone, x, angle, y, u);
        memset(o->learning.filters, 0, sizeof *o->learning.filters);
        hystmpc_learning_init(m->learner, o->learning.past, o->learning.filters, angle, u, y);
        if (n.alone)
            memcpy(o->learning.behind, o->learning.past, sizeof(real) * (size_t)hystmpc_numbers_past(m->learner));
        observer_put_together(m, &n, o);
    }
    if (s->sensor == HYSTMPC_FRAMES) hystmpc_frames_init(o, y);
    return HYSTMPC_STARTED;
}

HYSTMPC_LOCAL real hystmpc_believed(const hystmpc_sensing *s, const hystmpc_estimate *e) {
    if (!s->logs) return R(1.0);
    const real noise = hystmpc_noise_sensor(s->noise, e->bank, s->logs);
    const real share = clamp(e->known->earned[0] / (e->known->earned[1] + s->doubt * noise), R(0.0), R(1.0));
    if (s->sensor == HYSTMPC_FRAMES) return share; /* few as they are, one alone says nothing */
    const real far = R(1.0) - hystmpc_noise_close(s->noise, e->bank);
    return R(1.0) - (R(1.0) - far * far) * (R(1.0) - share);
}

/* The bank with an offset used, and the disturbance as far as it is believed, never away from the offset. */
static void observer_believe(const hystmpc_sensing *s, hystmpc_estimate *e, real offset) {
    hystmpc_known *known = e->known;
    const real before = hystmpc_noise_mean(s->noise, e->bank);
    real mean;
    const real variance = hystmpc_noise_correct(s->noise, e->bank, offset, &mean);
    known->earned[0] += before * offset;
    known->earned[1] += before * before;
    const real old = known->disturbance, wanted = hystmpc_believed(s, e) * mean;
    known->disturbance = clamp(wanted, least(old, offset), most(old, offset));
    known->variance = variance + (mean - known->disturbance) * (mean - known->disturbance);
}

HYSTMPC_LOCAL void hystmpc_estimate_correct(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                            real y) {
    const real angle = hystmpc_usable_angle(y), offset = angle - e->angles[0], far = s->outlier;
    hystmpc_known *known = e->known;
    if (!(absolute(offset - known->disturbance) <= far || absolute(angle - known->measured) <= far)) {
        known->missing = hystmpc_later(known->missing);
        return;
    }
    known->measured = angle;
    known->missing = 0;
    if (e->responsive[0] != R(0.0) && n->bank) observer_believe(s, e, offset);
}

static void observer_drop_first(real *row, int count, real last) {
    for (int k = 0; k + 1 < count; k++) row[k] = row[k + 1];
    row[count - 1] = last;
}

HYSTMPC_LOCAL void hystmpc_disturbance_advance(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e) {
    hystmpc_known *known = e->known;
    if (n->bank) known->variance = hystmpc_noise_advance(s->noise, e->bank, e->moves[0], known->disturbance);
    known->earned[0] *= s->forgets;
    known->earned[1] *= s->forgets;
}

/* Without a sensor the travels stand still where the model does, and every sample counts as responsive. */
HYSTMPC_LOCAL void hystmpc_estimate_advance(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                            real u, const real *next, real angle) {
    hystmpc_known *known = e->known;
    const real moved = absolute(u - known->command), before = e->angles[n->angles - 1];
    const int sensed = s->sensor != HYSTMPC_NO_SENSOR;
    if (next) memcpy(e->model, next, sizeof(real) * (size_t)n->states);
    else angle = before;
    const int answers = absolute(angle - before) >= s->dead_band_gain * moved || moved <= s->resolution;
    known->stalled = next ? 0 : hystmpc_later(known->stalled);
    known->command = u;
    observer_drop_first(e->angles, n->angles, angle);
    if (next || sensed) observer_drop_first(e->moves, n->angles, moved);
    if (!sensed) return;
    observer_drop_first(e->responsive, n->angles, answers ? R(1.0) : R(0.0));
    hystmpc_disturbance_advance(s, n, e);
}

/* Model, learned part and disturbance corrected. Where weights change the disturbance takes up the difference, so that
 * the angle of now has no jump. An angle far from the prediction counts where the device can have gone there. */
static void observer_correct_learned(const hystmpc_sensing *s, const hystmpc_model *m, const hystmpc_extent *n,
                                     hystmpc_observed *o, real y) {
    const hystmpc_learning *l = &o->learning;
    hystmpc_known *whole = o->now.known, *plain = o->alone.known;
    const real angle = hystmpc_usable_angle(y), offset = angle - o->now.angles[0], before = l->added[0];
    const real reach = s->outlier + hystmpc_learning_reach(m->learner, l->past);
    if (!(absolute(offset - whole->disturbance) <= s->outlier || absolute(angle - whole->measured) <= reach)) {
        whole->missing = hystmpc_later(whole->missing);
        return;
    }
    hystmpc_learning_correct(m->learner, l->past, l->filters, angle, o->alone.angles[0], plain->disturbance);
    hystmpc_estimate_correct(s, n, &o->alone, angle);
    plain->command = whole->command;
    plain->measured = whole->measured = angle;
    plain->missing = whole->missing = 0;
    observer_put_together(m, n, o);
    const real change = l->added[0] - before;
    for (int i = 0; i < n->bank / 3; i++) o->now.bank[i] -= change;
    whole->disturbance -= change;
    if (o->alone.responsive[0] != R(0.0) && n->bank) observer_believe(s, &o->now, offset - change);
}

static void observer_correct_newest(const hystmpc_sensing *s, hystmpc_known *known, real y) {
    const real angle = hystmpc_usable_angle(y);
    if (is_finite(angle)) {
        known->measured = angle;
        known->missing = 0;
        known->since = R(0.0);
    } else if (s->sensor == HYSTMPC_NEWEST) known->missing = hystmpc_later(known->missing);
}

/* A frame that was taken before the one that is known changes nothing: the order of arrival makes no difference. */
static int observer_correct_frame(const hystmpc_sensing *s, hystmpc_observed *o, real y, real age) {
    const real angle = hystmpc_usable_angle(y);
    if (!(R(0.0) <= age && age <= (real)s->oldest) || !is_finite(angle)) return 0;
    if (age >= hystmpc_observer_age(o)) return 1;
    o->now.known->measured = angle;
    o->now.known->missing = (int)MATH(ceil)(age);
    o->now.known->since = MATH(ceil)(age) - age;
    return 1;
}

HYSTMPC_LOCAL int hystmpc_observer_input(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o, int entry,
                                         real value) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    if (entry < 0 || entry >= n.states || !is_finite(value)) return 0;
    o->now.model[entry] = value;
    if (observer_learns(s, m)) o->alone.model[entry] = value;
    return 1;
}

HYSTMPC_LOCAL void hystmpc_observer_correct(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                            real y) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    hystmpc_estimate *e = &o->now;
    if (s->sensor == HYSTMPC_FRAMES) hystmpc_frames_correct(s, &n, e, y);
    else if (s->sensor == HYSTMPC_NO_SENSOR) e->known->measured = e->angles[0];
    else if (observer_newest(s)) observer_correct_newest(s, e->known, y);
    else if (observer_learns(s, m)) observer_correct_learned(s, m, &n, o, y);
    else hystmpc_estimate_correct(s, &n, e, y);
}

HYSTMPC_LOCAL int hystmpc_observer_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                                real y, real age) {
    if (s->sensor == HYSTMPC_FRAMES) return hystmpc_frames_correct_late(s, m, o, y, age);
    if (s->sensor == HYSTMPC_NEWEST_FRAME) return observer_correct_frame(s, o, y, age);
    return 0;
}

HYSTMPC_LOCAL void hystmpc_observer_advance(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                            real u, char *room) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const int learns = observer_learns(s, m);
    hystmpc_estimate *modelled = learns ? &o->alone : &o->now;
    hystmpc_known *known = o->now.known;
    if (!observer_has_model(s, m)) {
        known->command = u;
        if (s->sensor == HYSTMPC_NEWEST_FRAME) known->missing = hystmpc_later(known->missing);
        return;
    }
    real *next = hystmpc_observer_work(m, room), angle = R(0.0);
    modelled->known->command = known->command; /* what the device really holds */
    const int advanced = hystmpc_next_of_model(m, modelled->model, u, next, &angle, room);
    if (n.alone) hystmpc_frames_teach(s, m, o, next + n.states);
    if (s->sensor == HYSTMPC_FRAMES) hystmpc_frames_keep(s, &n, o);
    hystmpc_estimate_advance(s, &n, modelled, u, advanced ? next : NULL, angle);
    if (!learns) return;
    hystmpc_learning_advance(m->learner, o->learning.past, u);
    known->command = u;
    known->stalled = o->alone.known->stalled;
    observer_put_together(m, &n, o);
    if (!n.alone) hystmpc_disturbance_advance(s, &n, &o->now);
}

/* Without an estimate of the model, and where nothing is learned, the numbers are zero. */
HYSTMPC_LOCAL void hystmpc_observer_state(const hystmpc_sensing *s, const hystmpc_model *m, const hystmpc_observed *o,
                                          real *x) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const int learns = observer_learns(s, m), learned = (int)(sizeof(hystmpc_learned) / sizeof(real));
    const int all = !m || !m->predictor ? 0 : m->predictor->states + (m->learner ? learned : 0);
    memcpy(x, learns ? o->alone.model : o->now.model, sizeof(real) * (size_t)n.states);
    for (int i = n.states; i < all; i++) x[i] = R(0.0);
    if (learns)
        hystmpc_learning_state(m->learner, o->learning.past, o->learning.filters,
                               (hystmpc_learned *)(void *)(x + n.states));
}

HYSTMPC_LOCAL real hystmpc_observer_age(const hystmpc_observed *o) {
    return (real)o->now.known->missing - o->now.known->since;
}

HYSTMPC_LOCAL real hystmpc_observer_sigma(const hystmpc_sensing *s, const hystmpc_observed *o) {
    return MATH(sqrt)(o->now.known->variance) * hystmpc_believed(s, &o->now);
}

HYSTMPC_LOCAL real hystmpc_observer_close(const hystmpc_sensing *s, const hystmpc_observed *o) {
    if (s->sensor == HYSTMPC_NO_SENSOR) return R(1.0);
    return s->noise ? hystmpc_noise_close(s->noise, o->now.bank) : R(0.0);
}
