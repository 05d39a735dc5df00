/* What the files of a chain share: the memory of a call, and a block of samples of one stage. */
#ifndef HYSTMPC_BLOCKS_H
#define HYSTMPC_BLOCKS_H

#include "chain.h"

/* Numbers of a row of a block. A microcontroller has memory for fewer; results do not depend on it. */
#ifndef HYSTMPC_BLOCK
#define HYSTMPC_BLOCK 256
#endif
#if HYSTMPC_BLOCK < 16 || HYSTMPC_BLOCK % 4 != 0
#error "hystmpc: HYSTMPC_BLOCK has to be a multiple of four, and at least 16"
#endif

enum { CHAIN_STRIDE = HYSTMPC_BLOCK + 8, CHAIN_HEAD = 8, CHAIN_STAGE = 9, CHAIN_MOST = 16 };

/* One stage of a chain, with the rows of its block. */
typedef struct {
    hystmpc_code p;
    const int *place, *wires;
    real **row;
    real *room;  /* of kept values and intermediate ones */
    real *state; /* states, each with one sample more than a block */
} chain_stage;

/* What a call works on. G rows abreast; a block has B / G samples, B = HYSTMPC_BLOCK, in rows of CHAIN_STRIDE numbers. */
typedef struct {
    int stages, states, signals, inputs, commands, outputs, abreast, directions; /* commands: inputs not scheduled */
    const int *shown;
    chain_stage *stage;
    real *signal;   /* (signals, stride) */
    real *by;       /* (signals, D, stride): their derivatives */
    real *moving;   /* (S, D, G): derivatives of the states at the block's first sample */
    real *history;  /* (states of a stage, stride + G): derivatives of its states in one direction along the block */
    int *begins;    /* (signals, D): first sample of the block in which a derivative is not zero; B: none */
    int *moves;     /* (S, D): whether a state has a derivative */
} chain_run;

/* Lay out the memory of a call; answers the bytes that it takes. Null for memory: the bytes alone. */
HYSTMPC_LOCAL long hystmpc_chain_lay_out(chain_run *r, const int *chain, int abreast, int directions, char *memory);

/* How many of so many rows run abreast: 1, or a multiple of four that leaves few lanes idle. */
HYSTMPC_LOCAL int hystmpc_chain_abreast(int rows);

/* Rows of all stages: kept values of rows n0 ... n0 + count - 1, the last one again in idle lanes; a short run fills no
 * more lanes than its samples need, and a table in C reads those of one sample. `last`: phase up to which it runs. */
HYSTMPC_LOCAL void hystmpc_chain_bind(const chain_run *r, const real *kept, int kept_rows, int n0, int count,
                                      int samples, int last);

/* A block of samples of one stage, up to phase `last`: behind, slopes or by_parameters; the states stand in the first column
 * and end in column `samples`. */
HYSTMPC_LOCAL void hystmpc_chain_run_stage(const chain_stage *s, int g, int samples, int last);

/* The derivatives of a block that ran with its slopes, in all directions; seeds (P, D) of the whole chain. */
HYSTMPC_LOCAL void hystmpc_chain_move_stage(const chain_run *r, const chain_stage *s, const real *seeds, int samples);

/* The last column of the states becomes the first one. */
HYSTMPC_LOCAL void hystmpc_chain_go_on(const chain_stage *s, int g, int samples);

/* Whether all scheduled inputs (ns, H) of a preview are finite numbers. Where one is not, no output may be trusted, and
 * none is a number: a play would take a command that is not a number for none, and show a finite angle. */
static inline int chain_knows(const int *chain, const real *known, int samples) {
    for (int i = 0; i < chain[7] * samples; i++)
        if (!known || !is_finite(known[i])) return 0;
    return 1;
}

static inline int smaller(int a, int b) { return a < b ? a : b; }

#endif
