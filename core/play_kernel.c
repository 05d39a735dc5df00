/* Predictions, sensitivities and inverse of a play-kernel model. */
#include "play_kernel.h"

typedef struct {
    real gain, lower, upper, bias, outer;
    const real *radii, *knots, *slopes, *levels, *stops;
    int size, segments; /* S = n + 1, K */
} play_kernel;

static play_kernel play_kernel_of(const real *m, int plays, int segments) {
    const int size = plays + 1;
    const real *radii = m + 5, *knots = radii + plays, *slopes = knots + segments + 1;
    const real *levels = slopes + size * segments, *stops = levels + size * segments;
    return (play_kernel){m[0], m[1], m[2], m[3], m[4], radii, knots, slopes, levels, stops, size, segments};
}

/* The segment k of the knots (K + 1,) with knot_k <= z < knot_(k+1); the first or the last one for a z beyond them. */
static int play_kernel_segment(real z, const real *knots, int segments) {
    int low = 0, high = segments + 1;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (z < knots[middle])
            high = middle;
        else
            low = middle + 1;
    }
    return low < 1 ? 0 : low > segments ? segments - 1 : low - 1;
}

static real play_kernel_step(const play_kernel *m, real *x, real u, real *slope) {
    const int size = m->size, segments = m->segments;
    const real inside = least(most(u, m->lower), m->upper);
    const real v = m->gain == R(1.0) ? inside : x[0] + m->gain * (inside - x[0]);
    real theta = m->bias + m->outer * (u - inside), stopped = R(0.0); /* d theta / d v through the stops */
    x[0] = v;
    for (int i = 1; i < size; i++) {
        const real z = x[i], r = m->radii[i - 1], held = least(v + r, z);
        x[i] = most(v - r, held);
        if (slope) slope[size + i] = v - r >= held || v + r <= z ? R(1.0) : R(0.0);
    }
    for (int i = 0; i < size; i++) {
        const real z = x[i], *knots = m->knots;
        const int k = play_kernel_segment(z, knots, segments);
        const real along = least(most(z - knots[k], R(0.0)), knots[k + 1] - knots[k]), s = m->slopes[i * segments + k];
        theta += m->levels[i * segments + k] + s * along;
        real by_z = knots[0] <= z && z <= knots[segments] ? s : R(0.0);
        if (i > 0) {
            const real stop = v - z, by_stop = m->stops[(stop < R(0.0) ? 0 : size - 1) + i - 1];
            theta += by_stop * stop;
            by_z -= by_stop;
            stopped += by_stop;
        }
        if (slope) slope[i] = by_z;
    }
    if (slope) {
        slope[0] += stopped;
        slope[size] = R(1.0);
        slope[2 * size] = m->lower <= u && u <= m->upper ? R(0.0) : m->outer;
    }
    return theta;
}

static void play_kernel_copy(real *to, const real *from, int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

real hystmpc_play_kernel_step(const real *model, int plays, int segments, real *x, real u, real *slope) {
    const play_kernel m = play_kernel_of(model, plays, segments);
    return play_kernel_step(&m, x, u, slope);
}

void hystmpc_play_kernel_rollout(const real *model, int plays, int segments, const real *state, const real *plans,
                                 int rows, int horizon, real *theta, real *work) {
    const play_kernel m = play_kernel_of(model, plays, segments);
    for (int n = 0; n < rows; n++) {
        play_kernel_copy(work, state, m.size);
        for (int t = 0; t < horizon; t++) theta[n * horizon + t] = play_kernel_step(&m, work, plans[n * horizon + t], 0);
    }
}

void hystmpc_play_kernel_linearise(const real *model, int plays, int segments, const real *state,
                                   const real *plan, int horizon, real *theta, real *jacobian, real *work) {
    const play_kernel m = play_kernel_of(model, plays, segments);
    const int size = m.size;
    real *x = work, *slope = x + size, *moving = slope + 2 * size + 1; /* d z_i / d u (S, H) */
    play_kernel_copy(x, state, size);
    for (int i = 0; i < size * horizon; i++) moving[i] = R(0.0);
    for (int t = 0; t < horizon; t++) {
        real *row = jacobian + t * horizon;
        theta[t] = play_kernel_step(&m, x, plan[t], slope);
        for (int j = 0; j < horizon; j++) moving[j] *= R(1.0) - m.gain;
        moving[t] = m.lower <= plan[t] && plan[t] <= m.upper ? m.gain : R(0.0);
        for (int j = 0; j < horizon; j++) row[j] = slope[0] * moving[j];
        for (int i = 1; i < size; i++) {
            real *own = moving + i * horizon;
            if (slope[size + i] > R(0.0)) play_kernel_copy(own, moving, horizon);
            for (int j = 0; j < horizon; j++) row[j] += slope[i] * own[j];
        }
        row[t] += slope[2 * size];
    }
}

real hystmpc_play_kernel_command(const real *model, int plays, int segments, const real *state, real wanted,
                                 real low, real high, real last, real *work) {
    const play_kernel m = play_kernel_of(model, plays, segments);
    const int size = m.size;
    real *x = work, *slope = x + size, u = least(most(last, low), high);
    const real tolerance = R(1e-11) * most(R(1.0), MATH(fabs)(wanted));
    for (int round = 0; round < 200; round++) {
        play_kernel_copy(x, state, size);
        const real miss = wanted - play_kernel_step(&m, x, u, slope);
        if (MATH(fabs)(miss) <= tolerance) break;
        if (miss > R(0.0))
            low = u;
        else
            high = u;
        if (high - low <= R(1e-13) * most(R(1.0), MATH(fabs)(high))) break;
        real d = R(0.0);
        if (m.lower <= u && u <= m.upper)
            for (int i = 0; i < size; i++) d += m.gain * slope[i] * slope[size + i];
        d += slope[2 * size];
        const real newton = d > R(0.0) ? u + miss / d : high + R(1.0);
        u = low < newton && newton < high ? newton : R(0.5) * (low + high);
    }
    return u;
}

void hystmpc_follow_plays(const real *command, int samples, real gain, const real *radii, int plays, real *now,
                          real *states) {
    const real *before = now;
    for (int k = 0; k < samples; k++) {
        real *restrict row = states + (long)k * (plays + 1);
        const real u = command[k], v = gain == R(1.0) ? u : before[0] + gain * (u - before[0]);
        row[0] = v;
        for (int i = 0; i < plays; i++) row[i + 1] = most(v - radii[i], least(v + radii[i], before[i + 1]));
        before = row;
    }
    if (samples > 0) play_kernel_copy(now, before, plays + 1);
}
