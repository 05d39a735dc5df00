/* Recursions of the withheld effects in blind/generators.py, over a signal (T,) in steps of dt [s]; `out` is (T,). */
#ifndef HYSTMPC_LAB_EFFECTS_H
#define HYSTMPC_LAB_EFFECTS_H

#include "lab.h"

/* Second-order lag x'' = w^2 (u - x) - 2 zeta w x', semi-implicit, from rest at the first input; w in rad/s. */
HYSTMPC_API void hystmpc_second_order(const double *u, int samples, double dt, double frequency, double damping,
                                      double *out);

/* Position loop over a velocity loop, from rest at the first input, with a delay of `lag` [s] on a ramp:
 * x' = v,  v' = b (r - v) + b^2 / 4 q,  q' = r - v,  r = clip((u - x) / lag, +-limit),  b = inner / lag. */
HYSTMPC_API void hystmpc_cascade(const double *u, int samples, double dt, double lag, double inner, double limit,
                                 double *out);

/* Overdamped LuGre block behind a spring of unit stiffness; all forces are in degrees of the spring:
 *
 *     drive - y = s0 z + s1 z' + s2 y',  z' = v - s0 |v| z / g(v),  g = Fs (r + (1 - r) exp(-(v / vs)^2)), v = y'
 *
 * (Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995, eq. (1)-(3)); z' is implicit. `numbers` are s0,
 * s1 [s] and s2 [s], break_away is Fs, ratio r and speed vs. */
HYSTMPC_API void hystmpc_lugre(const double *drive, int samples, double dt, double break_away, double ratio,
                               double speed, const double *numbers, double *out);

/* Smoothed direction d in -1..1: dd / d|x| = (sign(dx) - d) / length, from d = 0. */
HYSTMPC_API void hystmpc_direction(const double *x, int samples, double length, double *out);

/* Plastic set s with unit hardening: s' = rate max(bend - limit - s, 0)^exponent (Norton and Hoff). */
HYSTMPC_API void hystmpc_plastic(const double *bend, int samples, double dt, double limit, double exponent, double rate,
                                 double *out);

#endif
