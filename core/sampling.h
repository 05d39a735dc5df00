/* Random plans, what they say of the slope of the angles, and their weighted mean. */
#ifndef HYSTMPC_SAMPLING_H
#define HYSTMPC_SAMPLING_H

#include "hystmpc_core.h"
#include "law.h"

/* Each block of m rows of (N, m) made orthogonal in place; every row keeps its length. squares (N): room. */
HYSTMPC_API void hystmpc_make_orthogonal(int count, int size, real *normals, real *squares);

/* Admissible plans (N, H) = mean + deviations * (w shape), w (N, m) the `normals` made orthogonal; shape (m, H);
 * deviations (N) of each plan, or with `along` (H) of each sample. */
HYSTMPC_LOCAL void hystmpc_draw_plans(int count, int size, int samples, real *normals, const real *shape,
                                      const real *mean, const real *deviations, int along, real lower, real upper,
                                      real reach, real last, real *plans);

/* S F^-1 (H, m) of a linear fit to plans (N, H) and angles (N, H) around those of a start (H):
 *     theta_n - theta_0 ~ S z_n,  F z_n = p_n - p_0 at the `ends` (m) of the blocks,  with the weights 1 / |z_n|^4
 * whitening (m, m): F^-1, transposed; room: (m + 1) (m + H) numbers. */
HYSTMPC_API void hystmpc_fit_columns(int count, int samples, int size, const real *plans, const real *angles,
                                     const real *commands, const real *start, const int *ends,
                                     const real *whitening, real *room, real *columns);

/* Mean (H) of plans (N, H) with the weights exp(-(J - J_min) / lambda), lambda = temperature (median J - J_min); costs
 * J (N); room: N numbers. */
HYSTMPC_LOCAL void hystmpc_weighted_mean(int count, int samples, const real *plans, const real *costs,
                                         real temperature, real *room, real *mean);

#endif
