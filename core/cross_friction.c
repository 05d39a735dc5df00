/* A play in the plane, less the plays of both axes alone. See cross_friction.h. */
#include "cross_friction.h"

#include "linear.h"

int hystmpc_cross_states(const void *friction) {
    const hystmpc_cross_friction *const f = friction;
    return 2 + 4 * f->plays;
}

void hystmpc_cross_rest(const void *friction, const real *w, real *state) {
    const hystmpc_cross_friction *const f = friction;
    for (int k = 0; k < 1 + 2 * f->plays; k++) copy(w, state + 2 * k, 2);
}

void hystmpc_cross_run(const void *friction, int samples, const real *w, real *state, real *c) {
    const hystmpc_cross_friction *const f = friction;
    real *const v = state, *const both = state + 2, *const alone = both + 2 * f->plays;
    for (int t = 0; t < samples; t++) {
        real sum[2] = {R(0.0), R(0.0)};
        for (int i = 0; i < 2; i++) v[i] = w[i * samples + t] + f->keep * (v[i] - w[i * samples + t]);
        for (int j = 0; j < f->plays; j++) {
            const real r = f->radii[j], dx = v[0] - both[2 * j], dy = v[1] - both[2 * j + 1];
            const real apart = MATH(sqrt)(dx * dx + dy * dy), share = apart > r ? r / apart : R(1.0);
            both[2 * j] = v[0] - share * dx;
            both[2 * j + 1] = v[1] - share * dy;
            for (int i = 0; i < 2; i++) {
                real *const p = alone + 2 * j + i;
                *p = clamp(*p, v[i] - r, v[i] + r);
                sum[i] += f->weights[i * f->plays + j] * (both[2 * j + i] - *p);
            }
        }
        for (int i = 0; c && i < 2; i++) c[i * samples + t] = sum[i];
    }
}
