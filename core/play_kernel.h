/* Predictions of a play-kernel model; its equations stand in models/play_kernel/weights.py, `PlayKernelWeights`.
 *
 * A model of n plays and K segments is one array: gain, lower, upper, bias, outer slope; radii (n,); knots (K + 1,);
 * slopes (S, K) and levels (S, K), the value of each function where its segments start; stops (2, n). Its state is
 * [v, z_1, ..., z_n], S = n + 1. */
#ifndef HYSTMPC_PLAY_KERNEL_H
#define HYSTMPC_PLAY_KERNEL_H

#include "hystmpc_core.h"
#include "real.h"

/* Moves the state x (S,) on by the command u; returns the angle [deg].
 *
 * Unless it is a null pointer, `slope` (2 S + 1,) becomes d theta / d z_i (first d / d v without the stops), whether
 * play i moves (1 or 0), and last d theta / d u without the part through v. */
HYSTMPC_API real hystmpc_play_kernel_step(const real *model, int plays, int segments, real *x, real u,
                                          real *slope);

/* Angles theta (N, H) [deg] of plans (N, H) from one state (S,); work (S,). */
HYSTMPC_API void hystmpc_play_kernel_rollout(const real *model, int plays, int segments, const real *state,
                                             const real *plans, int rows, int horizon, real *theta, real *work);

/* Angles theta (H,) along a plan (H,) and their Jacobian (H, H) by forward sensitivity; work (3 S + 1 + S H,). */
HYSTMPC_API void hystmpc_play_kernel_linearise(const real *model, int plays, int segments, const real *state,
                                               const real *plan, int horizon, real *theta, real *jacobian,
                                               real *work);

/* Command in [low, high] whose next angle is `wanted` [deg], by Newton's method within brackets; work (3 S + 1,). */
HYSTMPC_API real hystmpc_play_kernel_command(const real *model, int plays, int segments, const real *state,
                                             real wanted, real low, real high, real last, real *work);

/* States (T, 1 + n) after each command (T,): v += gain (u - v), then p_i = max(v - r_i, min(v + r_i, p_i)). `now`
 * (1 + n,) is the state before the first command and becomes the last one. */
HYSTMPC_API void hystmpc_follow_plays(const real *command, int samples, real gain, const real *radii, int plays,
                                      real *now, real *states);

#endif
