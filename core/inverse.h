/* One sample of a chain at a time, in the registers of its stages. */
#ifndef HYSTMPC_INVERSE_H
#define HYSTMPC_INVERSE_H

#include "blocks.h"

/* One stage of a chain with the registers of its step. */
typedef struct {
    hystmpc_code p;
    const int *place;
    real *registers, *state;
} single_stage;

/* All stages; a signal of one axis goes from each to the next. */
typedef struct {
    int stages;
    single_stage *stage;
    real *last; /* room behind the registers: two states of the chain */
} single_chain;

/* Lay out the memory of a call and put in the kept values; answers the bytes that it takes. Null for memory: the bytes
 * alone. */
HYSTMPC_LOCAL long hystmpc_single_lay_out(single_chain *c, const int *chain, const real *kept, char *memory);

/* Put in the states; what they alone decide is computed. */
HYSTMPC_LOCAL void hystmpc_single_set(const single_chain *c, const real *x);

/* The angle at command u and its derivative, in a state that has been set. */
HYSTMPC_LOCAL real hystmpc_single_angle(const single_chain *c, real u, real *slope);

/* The state one sample after the command at which the angle has been computed last. */
HYSTMPC_LOCAL void hystmpc_single_move(const single_chain *c, real *x);

/* The command of a state that has been set. */
HYSTMPC_LOCAL real hystmpc_single_command(const single_chain *c, real wanted, real low, real high, real last);

#endif
