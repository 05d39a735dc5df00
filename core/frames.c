/* Frames of an imaging system, now and then and late: each is used at the instant at which it was taken.
 *
 * A frame of age a lies between the instants k and k + 1, a = now - k - s. The model's own motion carries it to k,
 *
 *     y_k = y + theta_k - ((1 - s) theta_k + s theta_{k+1}),   0 <= s < 1
 *
 * The estimate of that instant is corrected, and all later updates, by commands and measurements, are repeated. The order
 * in which frames arrive makes no difference. The last instants stand in a ring of blocks. What is learned is learned
 * at the oldest of them. */
#include "estimates.h"

#include <string.h>

#define FRAMES_NOISE R(4.0)  /* variances of a frame that count as noise of the learned part, whose basis is not exact */
#define FRAMES_FLOOR R(0.25) /* of them below which no forecast has to come */
#define FRAMES_KEPT R(0.9)   /* forgetting factor of a score, a block */
#define FRAMES_GAIN R(0.3)   /* by which a forecast has to be better: little else corrects the model between frames */
enum { FRAMES_FORECAST = 6 }; /* frames of a block of forecasts */

static int frames_count(const hystmpc_known *known) {
    return known->count < 0 ? 0 : known->count > HYSTMPC_SEEN ? HYSTMPC_SEEN : known->count;
}

/* Instants written so far, less whole rounds of a full ring: 0 ... 2 oldest - 1. */
static int frames_written(const hystmpc_sensing *s, const hystmpc_observed *o) {
    return 0 <= *o->instants && *o->instants < 2 * s->oldest ? *o->instants : 0;
}

static int frames_known(const hystmpc_sensing *s, const hystmpc_observed *o) {
    const int written = frames_written(s, o);
    return written < s->oldest ? written : s->oldest;
}

/* Block of a known instant, 0 for the oldest one; the present one behind them. */
static char *frames_block(const hystmpc_sensing *s, const hystmpc_extent *n, const hystmpc_observed *o, int instant) {
    const int known = frames_known(s, o);
    if (instant >= known) return (char *)(void *)o->now.known;
    return o->past + (long)((frames_written(s, o) - known + instant) % s->oldest) * hystmpc_estimate_bytes(n);
}

static void frames_remember(hystmpc_known *known, real y) {
    int count = frames_count(known);
    if (count == HYSTMPC_SEEN) {
        count--;
        memmove(known->seen, known->seen + 1, sizeof(real) * (size_t)count);
    }
    known->seen[count] = y;
    known->count = count + 1;
}

static void frames_forget(hystmpc_known *known) {
    memset(known->seen, 0, sizeof known->seen);
    known->count = 0;
}

HYSTMPC_LOCAL void hystmpc_frames_init(hystmpc_observed *o, real y) {
    *o->instants = 0;
    frames_remember(o->now.known, y);
}

/* An instant without a usable frame counts once as missing, and not at all where another one was usable. */
HYSTMPC_LOCAL void hystmpc_frames_correct(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                          real y) {
    const int before = e->known->missing;
    hystmpc_estimate_correct(s, n, e, y);
    if (frames_count(e->known) > 0 && before < e->known->missing) e->known->missing = before;
    frames_remember(e->known, hystmpc_usable_angle(y));
}

HYSTMPC_LOCAL void hystmpc_frames_keep(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_observed *o) {
    const int written = frames_written(s, o);
    const long bytes = hystmpc_estimate_bytes(n);
    if (s->oldest > 0) {
        memcpy(o->past + (written % s->oldest) * bytes, o->now.known, (size_t)bytes);
        *o->instants = written + 1 < 2 * s->oldest ? written + 1 : s->oldest;
    }
    frames_forget(o->now.known);
}

/* The estimate `after` anew from that one sample before it, with all its measurements; the model's part stays. */
static void frames_repeat(const hystmpc_sensing *s, const hystmpc_extent *n, char *before, char *after) {
    const hystmpc_estimate b = hystmpc_estimate_at(n, before), a = hystmpc_estimate_at(n, after);
    const hystmpc_known old = *a.known;
    hystmpc_estimate e = a;
    *a.known = *b.known;
    a.known->command = old.command;
    a.known->stalled = old.stalled;
    a.known->added = old.added;
    a.known->forecast_error = old.forecast_error;
    memcpy(a.bank, b.bank, sizeof(real) * (size_t)n->bank);
    frames_forget(a.known);
    hystmpc_disturbance_advance(s, n, &e);
    for (int i = 0; i < frames_count(&old); i++) hystmpc_frames_correct(s, n, &e, old.seen[i]);
}

HYSTMPC_LOCAL int hystmpc_frames_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                              real y, real age) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const int known = frames_known(s, o);
    if (!(R(0.0) <= age && age <= (real)known) || !is_finite(hystmpc_usable_angle(y))) return 0;
    const int back = (int)MATH(ceil)(age), first = known - back;
    hystmpc_estimate here = hystmpc_estimate_at(&n, frames_block(s, &n, o, first));
    const hystmpc_estimate next = hystmpc_estimate_at(&n, frames_block(s, &n, o, first + 1));
    const real carried = ((real)back - age) * (here.angles[0] - next.angles[0]);
    if (frames_count(here.known) == HYSTMPC_SEEN) return 0;
    hystmpc_frames_correct(s, &n, &here, y + carried);
    for (int k = first + 1; k <= known; k++) frames_repeat(s, &n, frames_block(s, &n, o, k - 1), frames_block(s, &n, o, k));
    return 1;
}

/* The learned part of all instants from the present weights, and their estimates anew from the oldest one: what is known
 * of later ones follows from their commands and frames as if these weights had always been known. The disturbance of
 * the oldest takes up what its angle gains, so that what was measured there is explained as before. */
static void frames_renew(const hystmpc_sensing *s, const hystmpc_model *m, const hystmpc_extent *n, hystmpc_observed *o,
                         real *work) {
    const hystmpc_learning *l = &o->learning;
    const int known = frames_known(s, o), numbers = hystmpc_numbers_past(m->learner);
    real *past = work, *added = work + numbers;
    memcpy(past, l->behind, sizeof(real) * (size_t)numbers);
    for (int k = 0; k <= known; k++) {
        hystmpc_estimate e = hystmpc_estimate_at(n, frames_block(s, n, o, k));
        if (k > 0) hystmpc_learning_advance(m->learner, past, e.known->command);
        hystmpc_learning_added(m->learner, past, l->filters, e.alone, added);
        const real change = added[0] - e.known->added;
        for (int i = 0; i < n->angles; i++) e.angles[i] = e.alone[i] + added[i];
        e.known->added = added[0];
        if (k > 0) {
            frames_repeat(s, n, frames_block(s, n, o, k - 1), frames_block(s, n, o, k));
            continue;
        }
        for (int i = 0; i < n->bank / 3; i++) e.bank[i] -= change;
        e.known->disturbance -= hystmpc_believed(s, &e) * change;
    }
}

/* No later frame can come of the oldest instant of a full ring: what was measured there is final. The filters stand at
 * that instant, so that a late frame never has to be learned twice. */
HYSTMPC_LOCAL void hystmpc_frames_teach(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                        real *work) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const hystmpc_learning *l = &o->learning;
    if (s->oldest < 1 || frames_known(s, o) < s->oldest) return;
    const hystmpc_estimate e = hystmpc_estimate_at(&n, frames_block(s, &n, o, 0));
    const hystmpc_estimate next = hystmpc_estimate_at(&n, frames_block(s, &n, o, 1));
    const real variance = hystmpc_noise_sensor(s->noise, e.bank, s->logs), acted = l->filters->share;
    hystmpc_learner taught = *m->learner;
    int used = 0;
    taught.noise = most(taught.noise, FRAMES_NOISE * variance);
    taught.floor = most(taught.floor, FRAMES_FLOOR * variance);
    taught.block = FRAMES_FORECAST;
    taught.kept = FRAMES_KEPT;
    taught.gain = FRAMES_GAIN;
    taught.expected = variance;
    for (int i = 0; i < frames_count(e.known); i++) {
        const real y = e.known->seen[i];
        if (!(absolute(y - e.angles[0] - e.known->disturbance) <= s->outlier)) continue;
        hystmpc_learning_correct(&taught, l->behind, l->filters, y, e.alone[0], e.known->disturbance + e.known->added);
        used = 1;
    }
    if (!used) hystmpc_learning_wait(m->learner, l->behind, l->filters);
    if (used && (acted > R(0.0) || l->filters->share > R(0.0))) frames_renew(s, m, &n, o, work);
    hystmpc_learning_advance(m->learner, l->behind, next.known->command);
}

#undef FRAMES_NOISE
#undef FRAMES_FLOOR
#undef FRAMES_KEPT
#undef FRAMES_GAIN
