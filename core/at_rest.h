/* Where an exported controller starts: the state of a predictor at rest, from the measured angle y and the command u.
 *
 * A rule is a tree as the predictor's. In series the drive rests at u; of a companion both rest at y; in parallel the
 * first shows y, the second 0. */
#ifndef HYSTMPC_AT_REST_H
#define HYSTMPC_AT_REST_H

#include "predictor.h"

enum {
    HYSTMPC_RULED = 0,   /* x = offset + by_angle y + by_command u, then the command is held */
    HYSTMPC_SETTLED = 1, /* a chain: every operator rests at the output of the one before it, the core at the angle at
                            which the whole shows y, or nearest to it; then the command is held */
    HYSTMPC_RESTS = 2    /* of the two parts of the predictor: first, second */
};

typedef struct hystmpc_rest_rule {
    int kind;
    int held;              /* samples */
    const real *offset;    /* (S) */
    const real *by_angle;  /* (S) */
    const real *by_command; /* (S) */
    const int *chain;
    const real *constants;
    const real *parameters;
    const real *kept;
    int core; /* its stage */
    const struct hystmpc_rest_rule *first;
    const struct hystmpc_rest_rule *second;
} hystmpc_rest_rule;

HYSTMPC_API long hystmpc_at_rest_bytes(const void *rule, const void *predictor);

/* x (S) at rest at the angle y [deg] under the command u; answers as the functions of a predictor. */
HYSTMPC_API int hystmpc_at_rest(const void *rule, const void *predictor, real y, real u, real *x, char *room);

#endif
