/* Friction cores of the drawn devices. */
#include "friction.h"

enum { SOLVES = 30 };

/* Newton's method for T0, whose end tensions are `following` (N,); `low` and `high` are the ends of the friction cones
 * over T0, without `drag`, whose factor is `scale`. */
static double proximal(double t0, double x, const double *tension, const double *low, const double *high,
                       const double *drag, double scale, int nodes, const double *shares, double rest,
                       double *following) {
    for (int round = 0; round < SOLVES; round++) {
        double total = 0.0, slope = 0.0;
        for (int i = 0; i < nodes; i++) {
            double value = tension[i], rate = 0.0;
            if (value < t0 * low[i] - scale * drag[i])
                value = t0 * low[i] - scale * drag[i], rate = low[i];
            else if (value > t0 * high[i] + scale * drag[i])
                value = t0 * high[i] + scale * drag[i], rate = high[i];
            else if (i == 0)
                value = t0, rate = 1.0;
            total += shares[i] * (value - rest);
            slope += shares[i] * rate;
            following[i] = value;
        }
        const double miss = x - total;
        if (fabs(miss) < 1e-9) break;
        t0 = most(t0 + miss / most(slope, shares[0]), 1e-6);
    }
    return t0;
}

/* Ends of the friction cones over T0. */
static void cones(double wrap, double curl, const double *tension, const double *weights, double rest, int nodes,
                  double *low, double *high) {
    double bend = 0.0;
    for (int i = 0; i < nodes; i++) {
        bend += weights[i] * (tension[i] - rest);
        high[i] = exp(wrap * (i / (nodes - 1.0) + curl * fabs(bend))), low[i] = 1 / high[i];
    }
}

void hystmpc_capstan(const double *x, int samples, double wrap, const double *scale, int stride, double curl,
                     double *tension, int nodes, const double *shares, const double *weights, const double *drag,
                     double rest, double *out) {
    double low[MOST_NODES], high[MOST_NODES], following[MOST_NODES];
    if (nodes < 1 || nodes > MOST_NODES) return;
    double t0 = tension[0];
    for (int k = 0; k < samples; k++) {
        const double factor = scale[k * stride];
        if (k == 0 || stride || curl > 0.0) cones(wrap * factor, curl, tension, weights, rest, nodes, low, high);
        t0 = proximal(t0, x[k], tension, low, high, drag, factor, nodes, shares, rest, following);
        double bend = 0.0;
        for (int i = 0; i < nodes; i++) {
            tension[i] = following[i];
            bend += weights[i] * (following[i] - rest);
        }
        out[k] = bend;
    }
}

void hystmpc_dahl(const double *x, int samples, const double *scale, int stride, const double *widths,
                  const double *shares, double *deflection, int elements, double *out) {
    double before = samples > 0 ? x[0] : 0.0;
    for (int k = 0; k < samples; k++) {
        const double step = x[k] - before;
        double total = 0.0;
        before = x[k];
        for (int i = 0; i < elements; i++) {
            const double width = widths[i] * scale[k * stride], side = step > 0 ? width : -width;
            if (step != 0.0) deflection[i] = side + (deflection[i] - side) * exp(-fabs(step) / width);
            total += shares[i] * deflection[i];
        }
        out[k] = total;
    }
}
