/* Predictions, sensitivities and inverse of a play-kernel model. */
#include "play_kernel.h"

#include "real.h"

typedef struct {
    double gain, lower, upper, bias, outer;
    const double *radii, *knots, *slopes, *levels, *stops;
    int size, segments; /* S = n + 1, K */
} Model;

static Model model_of(const double *m, int plays, int segments) {
    const int size = plays + 1;
    const double *radii = m + 5, *knots = radii + plays, *slopes = knots + segments + 1;
    const double *levels = slopes + size * segments, *stops = levels + size * segments;
    return (Model){m[0], m[1], m[2], m[3], m[4], radii, knots, slopes, levels, stops, size, segments};
}

/* The segment k of the knots (K + 1,) with knot_k <= z < knot_(k+1); the first or the last one for a z beyond them. */
static int segment_of(double z, const double *knots, int segments) {
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

static double step(const Model *m, double *x, double u, double *slope) {
    const int size = m->size, segments = m->segments;
    const double inside = least(most(u, m->lower), m->upper);
    const double v = m->gain == 1.0 ? inside : x[0] + m->gain * (inside - x[0]);
    double theta = m->bias + m->outer * (u - inside), stopped = 0.0; /* d theta / d v through the stops */
    x[0] = v;
    for (int i = 1; i < size; i++) {
        const double z = x[i], r = m->radii[i - 1], held = least(v + r, z);
        x[i] = most(v - r, held);
        if (slope) slope[size + i] = v - r >= held || v + r <= z ? 1.0 : 0.0;
    }
    for (int i = 0; i < size; i++) {
        const double z = x[i], *knots = m->knots;
        const int k = segment_of(z, knots, segments);
        const double along = least(most(z - knots[k], 0.0), knots[k + 1] - knots[k]), s = m->slopes[i * segments + k];
        theta += m->levels[i * segments + k] + s * along;
        double by_z = knots[0] <= z && z <= knots[segments] ? s : 0.0;
        if (i > 0) {
            const double stop = v - z, by_stop = m->stops[(stop < 0.0 ? 0 : size - 1) + i - 1];
            theta += by_stop * stop;
            by_z -= by_stop;
            stopped += by_stop;
        }
        if (slope) slope[i] = by_z;
    }
    if (slope) {
        slope[0] += stopped;
        slope[size] = 1.0;
        slope[2 * size] = m->lower <= u && u <= m->upper ? 0.0 : m->outer;
    }
    return theta;
}

static void copy(double *to, const double *from, int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

double hystmpc_play_kernel_step(const double *model, int plays, int segments, double *x, double u, double *slope) {
    const Model m = model_of(model, plays, segments);
    return step(&m, x, u, slope);
}

void hystmpc_play_kernel_rollout(const double *model, int plays, int segments, const double *state, const double *plans,
                                 int rows, int horizon, double *theta, double *work) {
    const Model m = model_of(model, plays, segments);
    for (int n = 0; n < rows; n++) {
        copy(work, state, m.size);
        for (int t = 0; t < horizon; t++) theta[n * horizon + t] = step(&m, work, plans[n * horizon + t], 0);
    }
}

void hystmpc_play_kernel_linearise(const double *model, int plays, int segments, const double *state,
                                   const double *plan, int horizon, double *theta, double *jacobian, double *work) {
    const Model m = model_of(model, plays, segments);
    const int size = m.size;
    double *x = work, *slope = x + size, *moving = slope + 2 * size + 1; /* d z_i / d u (S, H) */
    copy(x, state, size);
    for (int i = 0; i < size * horizon; i++) moving[i] = 0.0;
    for (int t = 0; t < horizon; t++) {
        double *row = jacobian + t * horizon;
        theta[t] = step(&m, x, plan[t], slope);
        for (int j = 0; j < horizon; j++) moving[j] *= 1.0 - m.gain;
        moving[t] = m.lower <= plan[t] && plan[t] <= m.upper ? m.gain : 0.0;
        for (int j = 0; j < horizon; j++) row[j] = slope[0] * moving[j];
        for (int i = 1; i < size; i++) {
            double *own = moving + i * horizon;
            if (slope[size + i] > 0.0) copy(own, moving, horizon);
            for (int j = 0; j < horizon; j++) row[j] += slope[i] * own[j];
        }
        row[t] += slope[2 * size];
    }
}

double hystmpc_play_kernel_command(const double *model, int plays, int segments, const double *state, double wanted,
                                   double low, double high, double last, double *work) {
    const Model m = model_of(model, plays, segments);
    const int size = m.size;
    double *x = work, *slope = x + size, u = least(most(last, low), high);
    const double tolerance = 1e-11 * most(1.0, fabs(wanted));
    for (int round = 0; round < 200; round++) {
        copy(x, state, size);
        const double miss = wanted - step(&m, x, u, slope);
        if (fabs(miss) <= tolerance) break;
        if (miss > 0.0)
            low = u;
        else
            high = u;
        if (high - low <= 1e-13 * most(1.0, fabs(high))) break;
        double d = 0.0;
        if (m.lower <= u && u <= m.upper)
            for (int i = 0; i < size; i++) d += m.gain * slope[i] * slope[size + i];
        d += slope[2 * size];
        const double newton = d > 0.0 ? u + miss / d : high + 1.0;
        u = low < newton && newton < high ? newton : 0.5 * (low + high);
    }
    return u;
}

void hystmpc_follow_plays(const double *command, int samples, double gain, const double *radii, int plays, double *now,
                          double *states) {
    const double *before = now;
    for (int k = 0; k < samples; k++) {
        double *restrict row = states + (long)k * (plays + 1);
        const double u = command[k], v = gain == 1.0 ? u : before[0] + gain * (u - before[0]);
        row[0] = v;
        for (int i = 0; i < plays; i++) row[i + 1] = most(v - radii[i], least(v + radii[i], before[i + 1]));
        before = row;
    }
    if (samples > 0) copy(now, before, plays + 1);
}
