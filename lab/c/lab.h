/* What all C files of the laboratory share. C99: no heap, no global state, no dependency but <math.h>. */
#ifndef HYSTMPC_LAB_H
#define HYSTMPC_LAB_H

#include <math.h>

/* Functions that Python calls; hystmpc's core/library.py reads their prototypes in the headers. */
#ifdef _WIN32
#define HYSTMPC_API __declspec(dllexport)
#else
#define HYSTMPC_API __attribute__((visibility("default")))
#endif

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* State of the C files that the library was compiled from, see hystmpc's core/build.py. */
HYSTMPC_API const char *hystmpc_digest(void);

/* The first number where one is not-a-number, as Python's `min` and `max`. */
static inline double least(double a, double b) { return b < a ? b : a; }
static inline double most(double a, double b) { return b > a ? b : a; }

#endif
