@USE@
#ifndef HYSTMPC_H
#define HYSTMPC_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "hystmpc: compiled for finite numbers only, which voids every check for not-a-number: leave out -ffast-math"
#endif

#ifdef __cplusplus
extern "C" {
#endif

@SIZES@
#ifndef HYSTMPC_CONTROLLER_H /* hystmpc.c has what follows from its engine */

typedef @REAL@ hystmpc_real;

@ENGINE@
#endif

typedef struct {
    union {
        double number;
        long long whole;
        void *place;
        unsigned char bytes[HYSTMPC_BYTES];
    } memory;
} hystmpc_controller;

@FUNCTIONS@

/* The next step makes no plan, and is answered by the fallbacks: for a sample that begins too late. */
void hystmpc_hurry(hystmpc_controller *c);

/* Latch the stop: every further step goes towards the safe command, or stays. Only hystmpc_init releases it. */
void hystmpc_stop(hystmpc_controller *c);

/* HYSTMPC_BYTES, for callers that cannot see the struct. */
unsigned long hystmpc_memory_bytes(void);

#ifdef __cplusplus
}
#endif
#endif
