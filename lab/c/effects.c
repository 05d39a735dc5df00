/* Recursions of the withheld effects. */
#include "effects.h"

void hystmpc_second_order(const double *u, int samples, double dt, double frequency, double damping, double *out) {
    const double pull = frequency * frequency, turn = dt * frequency;
    const double held = 1 + 2 * dt * damping * frequency + turn * turn;
    double x = samples > 0 ? u[0] : 0.0, v = 0.0;
    for (int k = 0; k < samples; k++) {
        v = (v + dt * pull * (u[k] - x)) / held;
        x += dt * v;
        out[k] = x;
    }
}

void hystmpc_cascade(const double *u, int samples, double dt, double lag, double inner, double limit, double *out) {
    const double band = inner / lag;
    double x = samples > 0 ? u[0] : 0.0, v = 0.0, q = 0.0;
    for (int k = 0; k < samples; k++) {
        const double wanted = least(most((u[k] - x) / lag, -limit), limit);
        v = (v + dt * band * (wanted + 0.25 * band * q)) / (1 + dt * band);
        q += dt * (wanted - v);
        x += dt * v;
        out[k] = x;
    }
}

void hystmpc_lugre(const double *drive, int samples, double dt, double break_away, double ratio, double speed,
                   const double *numbers, double *out) {
    const double s0 = numbers[0], s1 = numbers[1], s2 = numbers[2];
    double y = samples > 0 ? drive[0] : 0.0, z = 0.0, v = 0.0;
    for (int k = 0; k < samples; k++) {
        const double way = v / speed, g = break_away * (ratio + (1 - ratio) * exp(-(way * way)));
        const double decay = s0 * fabs(v) / most(g, 1e-9);
        /* Force balance at the end of the step, z and y implicit in v, the decay rate explicit. */
        const double keep = 1 / (1 + dt * decay);
        const double held = s0 * keep * z - s1 * decay * keep * z;
        const double per_v = dt + s0 * keep * dt + s1 * (1 - decay * keep * dt) + s2;
        v = (drive[k] - y - held) / per_v;
        z = keep * (z + dt * v);
        y += dt * v;
        out[k] = y;
    }
}

void hystmpc_direction(const double *x, int samples, double length, double *out) {
    double d = 0.0, before = samples > 0 ? x[0] : 0.0;
    for (int k = 0; k < samples; k++) {
        const double step = x[k] - before;
        before = x[k];
        if (step != 0.0) {
            const double side = step > 0 ? 1.0 : -1.0;
            d = side + (d - side) * exp(-fabs(step) / length);
        }
        out[k] = d;
    }
}

void hystmpc_plastic(const double *bend, int samples, double dt, double limit, double exponent, double rate,
                     double *out) {
    double s = 0.0;
    for (int k = 0; k < samples; k++) {
        s += dt * rate * pow(most(bend[k] - limit - s, 0.0), exponent);
        out[k] = s;
    }
}
