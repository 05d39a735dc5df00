/* Friction cores of the drawn devices: a tendon in a bent sheath and parallel Dahl elements. */
#ifndef HYSTMPC_LAB_FRICTION_H
#define HYSTMPC_LAB_FRICTION_H

#include "lab.h"

enum { MOST_NODES = 64 };

/* Bend out (T,) [mm] of a catheter with the tendon's proximal end at x (T,) [mm]; `tension` (N,) [N] is the state, N at
 * most MOST_NODES, else nothing is done. Quasi-static: every point keeps its tension unless the proximal one, T0, pulls
 * it out of its friction cone, wider by its dry friction d_i:
 *
 *     T_i <- clip(T_i, T0 exp(-kappa s_i) - d_i, T0 exp(+kappa s_i) + d_i),  x = sum shares_i (T_i - rest)
 *     out = sum weights_i (T_i - rest)
 *
 * s_i = i / (N - 1) + curl |bend of the points up to i|, as the tendon's way is bent with them [mm]. T0 meets the
 * displacement x. kappa is `wrap` and d is `drag` (N,) [N], both times `scale` (T,), or one number where stride is 0;
 * shares, weights (N,) [mm/N]. */
HYSTMPC_API void hystmpc_capstan(const double *x, int samples, double wrap, const double *scale, int stride,
                                 double curl, double *tension, int nodes, const double *shares,
                                 const double *weights, const double *drag, double rest, double *out);

/* Friction deflection out (T,) of parallel Dahl elements along x (T,); `deflection` (N,) is the state.
 *
 *     dd_i / d|x| = (sign(dx) w_i - d_i) / w_i,  out = sum shares_i d_i
 *
 * exact over a step of constant direction. w_i = widths_i (N,) times `scale` (T,), or one number where stride is 0. */
HYSTMPC_API void hystmpc_dahl(const double *x, int samples, const double *scale, int stride, const double *widths,
                              const double *shares, double *deflection, int elements, double *out);

#endif
