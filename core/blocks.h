/* What the files of a chain share: the memory of a call, and a block of samples of one stage. */
#ifndef HYSTMPC_BLOCKS_H
#define HYSTMPC_BLOCKS_H

#include "chain.h"

enum { LANES = 256, STRIDE = LANES + 8, CHAIN_HEAD = 7, STAGE = 9, MOST = 16 };

/* One stage of a chain, with the rows of its block. */
typedef struct {
    hystmpc_program p;
    const int *place, *wires;
    real **row;
    real *room;  /* of kept values and intermediate ones */
    real *state; /* states, each with one sample more than a block */
} chain_stage;

/* What a call works on. G rows abreast; a block has LANES / G samples. */
typedef struct {
    int stages, states, signals, inputs, outputs, abreast, directions;
    const int *shown;
    chain_stage *stage;
    real *signal;   /* (signals, STRIDE) */
    real *by;       /* (signals, D, STRIDE): their derivatives */
    real *moving;   /* (S, D, G): derivatives of the states at the block's first sample */
    real *history;  /* (states of a stage, STRIDE + G): derivatives of its states in one direction along the block */
    int *begins;    /* (signals, D): first sample of the block in which a derivative is not zero; LANES: none */
    int *moves;     /* (S, D): whether a state has a derivative */
} chain_run;

/* Lay out the memory of a call; answers the bytes that it takes. Null for memory: the bytes alone. */
long chain_lay_out(chain_run *r, const int *chain, int abreast, int directions, char *memory);

/* How many of so many rows run abreast: 1, or a multiple of four that leaves few lanes idle. */
int chain_abreast(int rows);

/* Rows of all stages: kept values of rows n0 ... n0 + count - 1, the last one again in idle lanes; a short run fills no
 * more lanes than its samples need. */
void chain_bind(const chain_run *r, const real *kept, int kept_rows, int n0, int count, int samples);

/* A block of samples of one stage; the states stand in the first column and end in column `samples`. */
void chain_run_stage(const chain_stage *s, int g, int samples, int slopes);

/* The last column of the states becomes the first one. */
void chain_go_on(const chain_stage *s, int g, int samples);

static inline int smaller(int a, int b) { return a < b ? a : b; }

#endif
