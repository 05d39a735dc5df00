/* What motions along both bending axes add to those of each alone: friction whose force is a vector, and static coupling.
 *
 *     v' = (w(t - delay) - v) / tau                     travels behind the drives (2)
 *     b_j <- v - (v - b_j) min(1, r_j / |v - b_j|)      play of radius r_j in the plane: b follows v at a distance
 *     p_ji <- max(v_i - r_j, min(v_i + r_j, p_ji))      the same of each axis alone
 *     c_i = sum_j k_ij (b_ji - p_ji) + g_i . (x o, o^2, x o^2, x^2 o, o^3)    x = v_i, o the other one
 *
 * A rod that slides along a sheath in one plane is free in the other one: its friction has one bound for both, and is zero
 * in motions of one axis. A rod that is bent in one plane is stiffer in the other one: static coupling. */
#ifndef HYSTMPC_CROSS_FRICTION_H
#define HYSTMPC_CROSS_FRICTION_H

#include "hystmpc_core.h"
#include "real.h"

enum {
    HYSTMPC_CROSS_MOST = 8,  /* plays, at most */
    HYSTMPC_CROSS_LATE = 64, /* samples of delay, at most */
    HYSTMPC_COUPLED = 5      /* products of the travels */
};

typedef struct {
    int plays;           /* J */
    int delay;           /* D samples */
    real keep;           /* exp(-dt / tau), 0 without a lag */
    const real *radii;   /* r (J) */
    const real *weights; /* k (2, J) */
    const real *coupling; /* g (2, 5); null: none */
} hystmpc_cross_friction;

/* Numbers of a state: v (2), b (J, 2), p (J, 2), then travels on their way (D, 2), the next one first. */
HYSTMPC_API int hystmpc_cross_states(const void *friction);

/* The state (see above) at rest at travels w (2). */
HYSTMPC_API void hystmpc_cross_rest(const void *friction, const real *w, real *state);

/* T samples of travels w (2, T): c (2, T) behind each; the state moves on. Null for c: the state alone. */
HYSTMPC_API void hystmpc_cross_run(const void *friction, int samples, const real *w, real *state, real *c);

/* Numbers of room for the derivatives. */
HYSTMPC_API long hystmpc_cross_room(const void *friction, int samples);

/* The same with derivatives of c_i in sample t by w_a in sample s <= t, added to slopes (2, 2, T, T); rows i, a, t. */
HYSTMPC_API void hystmpc_cross_slopes(const void *friction, int samples, const real *w, real *state, real *c,
                                      real *slopes, real *room);

#endif
