/* What predicts the angle from a state under commands: a chain of operators, a recurrent network, two of them put
 * together, or a predictor written in Python; and the inverse of what predicts.
 *
 * A predictor is a tree of constant structs: an exported controller has the same tree as text. Its state x (S) is a flat
 * row of numbers. All functions answer 0, or another number where a predictor from outside has failed; angles that are
 * not finite are no failure. `room` is memory for one call, of `hystmpc_predictor_bytes`. */
#ifndef HYSTMPC_PREDICTOR_H
#define HYSTMPC_PREDICTOR_H

#include "follow.h"

/* Functions of a predictor or of an inverse that is written in Python; 0, or another number where it failed. */
typedef struct {
    int (*advance)(real *x, real u, real *theta);
    int (*run)(const real *x, int rows, int samples, const real *plans, real *angles);
    int (*linearise)(const real *x, int samples, const real *plan, real *angles, real *jacobian);
    int (*command)(const real *x, int states, real theta, real u_last, real *u);
} hystmpc_outside;

enum {
    HYSTMPC_CHAIN = 0,       /* operators: chain, kept */
    HYSTMPC_RECURRENT = 1,   /* network; not-a-number where state or command is not finite: gates would hide it */
    HYSTMPC_SERIES = 2,      /* second behind the drive `first`: theta = second(first(u)); x = [first, second] */
    HYSTMPC_PARALLEL = 3,    /* theta = first(u) + second(u); x = [first, second] */
    HYSTMPC_ACCOMPANIED = 4, /* theta = first(u), beside it second(u); x = [first, its angle, second, its angle] */
    HYSTMPC_WRITTEN = 5      /* in Python: outside */
};

typedef struct hystmpc_predictor {
    int kind;
    int states; /* S */
    const int *chain;
    const real *kept;
    const hystmpc_network *network;
    const struct hystmpc_predictor *first;
    const struct hystmpc_predictor *second;
    const hystmpc_outside *outside;
} hystmpc_predictor;

/* Room for up to so many rows of so many samples, a linearisation over them included. */
HYSTMPC_API long hystmpc_predictor_bytes(const void *predictor, int rows, int samples);

/* One sample later, in place; where it fails the state stays as it was. */
HYSTMPC_API int hystmpc_predictor_advance(const void *predictor, real *x, real u, real *theta, char *room);

/* Angles (N, H) of plans (N, H), all from one state. */
HYSTMPC_API int hystmpc_predictor_run(const void *predictor, const real *x, int rows, int samples, const real *plans,
                                      real *angles, char *room);

/* Angles (H) along one plan (H), and their derivatives (H, H) by its commands, lower triangular. */
HYSTMPC_API int hystmpc_predictor_linearise(const void *predictor, const real *x, int samples, const real *plan,
                                            real *angles, real *jacobian, char *room);

enum {
    HYSTMPC_EXACT = 0,     /* the one-step inverse of the chain `predictor`, within low ... high */
    HYSTMPC_COMPANION = 1, /* inner, the inverse of what accompanies `predictor`, at the wanted angle and what the
                              companion is now above the model */
    HYSTMPC_DRIVEN = 2,    /* inner, the inverse of `predictor`, between the drives front and back (null: none);
                              x = [front, predictor, back] */
    HYSTMPC_ANSWERED = 3   /* by Python: outside */
};

typedef struct hystmpc_inverse {
    int kind;
    const hystmpc_predictor *predictor;
    const struct hystmpc_inverse *inner;
    const hystmpc_predictor *front;
    const hystmpc_predictor *back;
    real low, high;
    const hystmpc_outside *outside;
} hystmpc_inverse;

/* Room for an inverse over so many samples; `predictor` is that of its state. */
HYSTMPC_API long hystmpc_inverse_bytes(const void *inverse, const void *predictor, int samples);

/* The command whose next angle is theta in the state x (S): that which brings a driven model to rest there. */
HYSTMPC_API int hystmpc_inverse_command(const void *inverse, const real *x, int states, real theta, real u_last,
                                        real *u, char *room);

/* Commands (2, H) along the angles `wanted` (H) from the state of `predictor`: row 0 within the box of the bounds (low,
 * high, reach), row 1 also by no more than `reach` in a sample. In a state that is not finite: the last command. */
HYSTMPC_API int hystmpc_inverse_follow(const void *inverse, const void *predictor, const real *x, const real *wanted,
                                       int samples, real u_last, const real *bounds, real *plans, char *room);

#endif
