/* Friction that two bending axes share: what a friction whose force is a vector adds to that of each axis alone.
 *
 *     v' = (w - v) / tau                                travels behind the drives (2)
 *     b_j <- v - (v - b_j) min(1, r_j / |v - b_j|)      play of radius r_j in the plane: b follows v at a distance
 *     p_ji <- max(v_i - r_j, min(v_i + r_j, p_ji))      the same of each axis alone
 *     c_i = sum_j k_ij (b_ji - p_ji)                    zero in motions of one axis
 *
 * A rod that slides along a sheath in one plane is free in the other one: its friction has one bound for both. */
#ifndef HYSTMPC_CROSS_FRICTION_H
#define HYSTMPC_CROSS_FRICTION_H

#include "hystmpc_core.h"
#include "real.h"

enum { HYSTMPC_CROSS_MOST = 8 }; /* plays, at most */

typedef struct {
    int plays;           /* J */
    int spare;
    real keep;           /* exp(-dt / tau), 0 without a drive */
    const real *radii;   /* r (J) */
    const real *weights; /* k (2, J) */
} hystmpc_cross_friction;

/* Numbers of a state: v (2), b (J, 2), p (J, 2). */
HYSTMPC_API int hystmpc_cross_states(const void *friction);

/* The state (see above) at rest at travels w (2). */
HYSTMPC_API void hystmpc_cross_rest(const void *friction, const real *w, real *state);

/* T samples of travels w (2, T): c (2, T) behind each; the state moves on. Null for c: the state alone. */
HYSTMPC_API void hystmpc_cross_run(const void *friction, int samples, const real *w, real *state, real *c);

#endif
