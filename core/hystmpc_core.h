/* What all files of the engine share. C99: no heap, no global state, no dependency but <math.h>. */
#ifndef HYSTMPC_CORE_H
#define HYSTMPC_CORE_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "hystmpc: compiled for finite numbers only, which voids every check for not-a-number: leave out -ffast-math"
#endif

/* Functions that Python calls; library.py reads their prototypes in the headers. An exported controller, where all files
 * are one, makes these and all others `static`. */
#ifndef HYSTMPC_API
#ifdef _WIN32
#define HYSTMPC_API __declspec(dllexport)
#else
#define HYSTMPC_API __attribute__((visibility("default")))
#endif
#endif

/* Functions that other C files call. */
#ifndef HYSTMPC_LOCAL
#define HYSTMPC_LOCAL
#endif

/* State of the C files that the library was compiled from, see build.py. */
HYSTMPC_API const char *hystmpc_digest(void);

/* Best level of vector instructions that this processor and its operating system have: 4 for AVX-512, 3 for AVX2 with
 * FMA, 0 for neither. */
HYSTMPC_API int hystmpc_level(void);

#endif
