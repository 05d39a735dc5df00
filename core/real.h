/* The number that the engine computes with, and small functions on it. A product and a sum are rounded each: the library
 * and every exported controller are compiled with -ffp-contract=off. */
#ifndef HYSTMPC_REAL_H
#define HYSTMPC_REAL_H

#include <math.h>

#ifndef HYSTMPC_SINGLE
#define HYSTMPC_SINGLE 0 /* 1: an exported controller for a processor without double precision */
#endif

#if HYSTMPC_SINGLE
typedef float real;
#define R(x) x##f
#define MATH(name) name##f
#else
typedef double real;
#define R(x) x
#define MATH(name) name
#endif

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* C has no `min` of its own that answers the first number where one is not-a-number, as Python's comparisons do. */
static inline real least(real a, real b) { return b < a ? b : a; }
static inline real most(real a, real b) { return b > a ? b : a; }
static inline real clamp(real x, real low, real high) { return least(most(x, low), high); }
static inline real absolute(real x) { return MATH(fabs)(x); }
static inline int is_finite(real x) { return x - x == R(0.0); }

#endif
