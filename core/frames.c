/* Frames of an imaging system, now and then and late: each is used at the instant at which it was taken.
 *
 * A frame of age a lies between the instants k and k + 1, a = now - k - s. The model's own motion carries it to k,
 *
 *     y_k = y + theta_k - ((1 - s) theta_k + s theta_{k+1}),   0 <= s < 1
 *
 * The estimate of that instant is corrected, and all later updates, by commands and measurements, are repeated. The order
 * in which frames arrive makes no difference. The last instants stand in a ring of blocks. */
#include "estimates.h"

#include <string.h>

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

/* A row of states (S) and angle for each instant. */
HYSTMPC_LOCAL long hystmpc_frames_work(const hystmpc_sensing *s, const hystmpc_extent *n) {
    return (long)s->oldest * (n->states + 1) * (long)sizeof(real);
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

/* The estimate `after` anew: that one sample before it under the command that was sent, to the state and the angle in
 * `row`, then with all its measurements. */
static void frames_repeat(const hystmpc_sensing *s, const hystmpc_extent *n, char *before, char *after,
                          const real *row) {
    hystmpc_estimate e = hystmpc_estimate_at(n, after);
    const hystmpc_known old = *e.known;
    memcpy(after, before, (size_t)hystmpc_estimate_bytes(n));
    frames_forget(e.known);
    hystmpc_estimate_advance(s, n, &e, old.command, row, row[n->states]);
    for (int i = 0; i < frames_count(&old); i++) hystmpc_frames_correct(s, n, &e, old.seen[i]);
}

/* The model's states come first: where one fails the frame is refused, and nothing has been written. */
HYSTMPC_LOCAL int hystmpc_frames_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                              real y, real age, char *room) {
    const hystmpc_extent n = hystmpc_extent_of(s, m);
    const int known = frames_known(s, o);
    if (!(R(0.0) <= age && age <= (real)known) || !is_finite(hystmpc_usable_angle(y))) return 0;
    const int back = (int)MATH(ceil)(age), first = known - back;
    hystmpc_estimate here = hystmpc_estimate_at(&n, frames_block(s, &n, o, first));
    const hystmpc_estimate next = hystmpc_estimate_at(&n, frames_block(s, &n, o, first + 1));
    const real carried = ((real)back - age) * (here.angles[0] - next.angles[0]), *x = here.model;
    real *work = hystmpc_observer_work(m, room), *row = work;
    if (frames_count(here.known) == HYSTMPC_SEEN) return 0;
    for (int k = first + 1; k <= known; k++, x = row, row += n.states + 1) {
        const hystmpc_estimate after = hystmpc_estimate_at(&n, frames_block(s, &n, o, k));
        if (!hystmpc_next_of_model(m, x, after.known->command, row, row + n.states, room)) return 0;
    }
    hystmpc_frames_correct(s, &n, &here, y + carried);
    for (int k = first + 1; k <= known; k++, work += n.states + 1)
        frames_repeat(s, &n, frames_block(s, &n, o, k - 1), frames_block(s, &n, o, k), work);
    return 1;
}
