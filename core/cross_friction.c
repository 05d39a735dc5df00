/* A play in the plane, less the plays of both axes alone. See cross_friction.h. */
#include "cross_friction.h"

#include "linear.h"

#include <stddef.h>

int hystmpc_cross_states(const void *friction) {
    const hystmpc_cross_friction *const f = friction;
    return 2 + 4 * f->plays + 2 * f->delay;
}

void hystmpc_cross_rest(const void *friction, const real *w, real *state) {
    const hystmpc_cross_friction *const f = friction;
    for (int k = 0; k < 1 + 2 * f->plays + f->delay; k++) copy(w, state + 2 * k, 2);
}

/* Derivatives in a call over T samples: of v_i by w_i (T), of b (J, 2) by both travels (2, T), of p by its own (J, 2, T). */
typedef struct {
    int samples;
    real *lagged, *both, *alone;
} cross_slopes;

/* b and p of play j behind v; answers r / |v - b| where b slides, else 1, and v - b. */
static real cross_slide(const hystmpc_cross_friction *f, int j, const real *v, real *both, real *alone, real *off) {
    const real r = f->radii[j], dx = v[0] - both[0], dy = v[1] - both[1];
    const real apart = MATH(sqrt)(dx * dx + dy * dy), share = apart > r ? r / apart : R(1.0);
    off[0] = dx;
    off[1] = dy;
    both[0] = v[0] - share * dx;
    both[1] = v[1] - share * dy;
    for (int i = 0; i < 2; i++) alone[i] = clamp(alone[i], v[i] - r, v[i] + r);
    return share;
}

/* The derivatives of play j where it slides: b = v - r n with n the direction of v - b (`off`). That of n is across n. */
static void cross_slide_slopes(const cross_slopes *d, int j, int count, real share, const real *off, const int *slid) {
    const int t = d->samples;
    const real apart = share < R(1.0) ? MATH(sqrt)(off[0] * off[0] + off[1] * off[1]) : R(1.0);
    const real along[2] = {off[0] / apart, off[1] / apart};
    for (int a = 0; a < 2 && share < R(1.0); a++) {
        real *const bx = d->both + (4 * j + a) * t, *const by = bx + 2 * t;
        for (int s = 0; s < count; s++) {
            const real gx = (a ? R(0.0) : d->lagged[s]) - bx[s], gy = (a ? d->lagged[s] : R(0.0)) - by[s];
            const real out = gx * along[0] + gy * along[1];
            bx[s] += gx - share * (gx - along[0] * out);
            by[s] += gy - share * (gy - along[1] * out);
        }
    }
    for (int i = 0; i < 2; i++)
        if (slid[i]) copy(d->lagged, d->alone + (2 * j + i) * t, count);
}

/* Products of the travels for axis i, and their derivatives by both travels (2, 5). */
static void cross_products(const real *v, int i, real *made, real *by) {
    const real x = v[i], o = v[1 - i];
    const real products[HYSTMPC_COUPLED] = {x * o, o * o, x * o * o, x * x * o, o * o * o};
    const real by_own[HYSTMPC_COUPLED] = {o, R(0.0), o * o, R(2.0) * x * o, R(0.0)};
    const real by_other[HYSTMPC_COUPLED] = {x, R(2.0) * o, R(2.0) * x * o, x * x, R(3.0) * o * o};
    copy(products, made, HYSTMPC_COUPLED);
    copy(by_own, by + i * HYSTMPC_COUPLED, HYSTMPC_COUPLED);
    copy(by_other, by + (1 - i) * HYSTMPC_COUPLED, HYSTMPC_COUPLED);
}

/* Static coupling at travels v: added to c (2), and its derivatives to the rows. */
static void cross_couple(const hystmpc_cross_friction *f, const real *v, real *sum, const cross_slopes *d, int count,
                         real *const *rows) {
    for (int i = 0; f->coupling && i < 2; i++) {
        const real *const weights = f->coupling + i * HYSTMPC_COUPLED;
        real made[HYSTMPC_COUPLED], by[2 * HYSTMPC_COUPLED];
        cross_products(v, i, made, by);
        for (int k = 0; k < HYSTMPC_COUPLED; k++) sum[i] += weights[k] * made[k];
        for (int a = 0; d && a < 2; a++) {
            real slope = R(0.0);
            for (int k = 0; k < HYSTMPC_COUPLED; k++) slope += weights[k] * by[a * HYSTMPC_COUPLED + k];
            add_rows(rows[2 * i + a], count, &slope, 1, d->lagged, 0, 1);
        }
    }
}

/* One sample at input w (2): c (2), and its derivatives by the first `count` samples where there are any. */
static void cross_sample(const hystmpc_cross_friction *f, const real *w, real *state, real *sum, const cross_slopes *d,
                         int count, real *const *rows) {
    real *const v = state, *const both = state + 2, *const alone = both + 2 * f->plays;
    for (int i = 0; i < 2; i++) v[i] = w[i] + f->keep * (v[i] - w[i]), sum[i] = R(0.0);
    cross_couple(f, v, sum, d, count, rows);
    for (int j = 0; j < f->plays; j++) {
        real off[2];
        const real before[2] = {alone[2 * j], alone[2 * j + 1]};
        const real share = cross_slide(f, j, v, both + 2 * j, alone + 2 * j, off);
        for (int i = 0; i < 2; i++) sum[i] += f->weights[i * f->plays + j] * (both[2 * j + i] - alone[2 * j + i]);
        if (!d) continue;
        const int slid[2] = {alone[2 * j] != before[0], alone[2 * j + 1] != before[1]};
        cross_slide_slopes(d, j, count, share, off, slid);
        for (int i = 0; i < 2; i++) {
            const real weight = f->weights[i * f->plays + j], less = -weight;
            for (int a = 0; a < 2; a++) add_rows(rows[2 * i + a], count, &weight, 1, d->both + (4 * j + 2 * i + a) * d->samples, 0, 1);
            add_rows(rows[3 * i], count, &less, 1, d->alone + (2 * j + i) * d->samples, 0, 1);
        }
    }
}

/* Samples of a call; with derivatives where `slopes` is not null. */
static void cross_samples(const hystmpc_cross_friction *f, int samples, const real *w, real *state, real *c,
                          const cross_slopes *d, real *slopes) {
    real *const waiting = state + 2 + 4 * f->plays;
    for (int t = 0; t < samples; t++) {
        real input[2], sum[2], *rows[4] = {NULL, NULL, NULL, NULL};
        const int count = t - f->delay + 1; /* samples that act by now */
        for (int i = 0; i < 2; i++) input[i] = count > 0 ? w[i * samples + t - f->delay] : waiting[2 * t + i];
        for (int k = 0; d && k < 4; k++) rows[k] = slopes + (k * samples + t) * samples;
        for (int s = 0; d && s < count; s++) d->lagged[s] = s + 1 < count ? f->keep * d->lagged[s] : R(1.0) - f->keep;
        cross_sample(f, input, state, sum, count > 0 ? d : NULL, count, rows);
        for (int i = 0; c && i < 2; i++) c[i * samples + t] = sum[i];
    }
    for (int k = 0; k < f->delay; k++)
        for (int i = 0; i < 2; i++) {
            const int at = samples - f->delay + k;
            waiting[2 * k + i] = at >= 0 ? w[i * samples + at] : waiting[2 * (k + samples) + i];
        }
}

void hystmpc_cross_run(const void *friction, int samples, const real *w, real *state, real *c) {
    cross_samples(friction, samples, w, state, c, NULL, NULL);
}

long hystmpc_cross_room(const void *friction, int samples) {
    const hystmpc_cross_friction *const f = friction;
    return (1 + 6L * f->plays) * samples;
}

void hystmpc_cross_slopes(const void *friction, int samples, const real *w, real *state, real *c, real *slopes, real *room) {
    const hystmpc_cross_friction *const f = friction;
    const cross_slopes d = {samples, room, room + samples, room + (1L + 4 * f->plays) * samples};
    fill(room, R(0.0), (int)hystmpc_cross_room(f, samples));
    cross_samples(f, samples, w, state, c, &d, slopes);
}
