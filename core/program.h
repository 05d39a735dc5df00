/* Programs: one step of an operator, y = f(x, u, p, dt) and x' = g(x, u, p, dt), as numbers.
 *
 * An instruction is five whole numbers: operation, result, three arguments (operations.h lists the operations). It acts on
 * lanes, numbers side by side that do not know each other: trials, plans, or samples where nothing depends on the sample
 * before. A block has B samples of G rows; lane t G + n is sample t of row n.
 *
 * A program's table, whole numbers:
 *
 *     1 + 19             length of this head, sizes in the order of hystmpc_program, lengths of the phases
 *     kept               registers of the kept values behind phase `once`
 *     5 each             instructions of all phases
 *     3 each             slopes: by x, u or p (0, 1, 2), which entry, row of its value
 *     states+outputs+1   first slope of every next state, of every output, and the end
 *     n, then n states   groups of states, each of which needs itself and earlier groups alone
 *     1+outputs+states   registers of one step: slope of the output by the input, outputs, next states
 *
 * The table's rows: kept values, states, next states, inputs, outputs, room. The row of a next state is that of the
 * state one sample later. */
#ifndef HYSTMPC_PROGRAM_H
#define HYSTMPC_PROGRAM_H

#include "hystmpc_core.h"
#include "operations.h"

#include <stddef.h>

enum hystmpc_phase {
    PHASE_ONCE, PHASE_AHEAD, PHASE_THROUGH, PHASE_BEHIND, PHASE_SLOPES, PHASE_BY_PARAMETERS, PHASE_FIXED, PHASE_MOVING,
    PHASE_REST, PHASES
};

enum { CODE_WORDS = 5 }; /* numbers of an instruction */

/* A table as C functions, whose results are those of its instructions to the last bit. An exported controller has them;
 * codegen/straight.py writes them. */
typedef struct {
    void (*run)(real *const *row, int abreast, int samples); /* phases ahead, through and behind, rows side by side */
    void (*slopes)(real *const *row, int samples);           /* and slopes by states and inputs, of one row */
    void (*moving)(real *registers);
} hystmpc_straight;

typedef struct {
    int states, inputs, parameters, outputs;
    int kept;      /* values that parameters and sample time alone decide */
    int rows;      /* of a block's table */
    int slopes;    /* derivatives that are not zero by structure */
    int groups;    /* of states */
    int registers; /* of phase `once`: parameters, sample time, constants, results */
    int single;    /* registers of one step: kept values, states, inputs, results */
    int length[PHASES];
    const int *code[PHASES];
    const int *keeps, *slope, *first, *group, *results;
    const hystmpc_straight *straight; /* null: its instructions are interpreted */
} hystmpc_code;

/* The functions of a table; null where it has none. */
#ifdef HYSTMPC_STRAIGHT
HYSTMPC_LOCAL const hystmpc_straight *hystmpc_straight_for(const int *table);
#else
static inline const hystmpc_straight *hystmpc_straight_for(const int *table) {
    (void)table;
    return NULL;
}
#endif

/* Where the parts of a table lie; answers the number of whole numbers read. */
HYSTMPC_LOCAL int hystmpc_code_read(const int *table, hystmpc_code *p);

/* Instructions on `lanes` numbers a row, a multiple of four; row r begins at row[r] + at. */
HYSTMPC_LOCAL void hystmpc_code_lanes(const int *code, int length, real *const *row, int at, int lanes);

/* Instructions on one number a row, sample after sample: row[r] + t for t = first, ..., first + samples - 1. */
HYSTMPC_LOCAL void hystmpc_code_samples(const int *code, int length, real *const *row, int first, int samples);

/* Instructions on registers. */
HYSTMPC_LOCAL void hystmpc_code_single(const int *code, int length, real *registers);

/* What the input moves, on the registers of one step. */
HYSTMPC_LOCAL void hystmpc_code_moving(const hystmpc_code *p, real *registers);

/* Kept values (kept) by parameters (P) and sample time [s]; room for `registers` numbers. */
HYSTMPC_LOCAL void hystmpc_code_prepare(const hystmpc_code *p, const real *constants, int count,
                                        const real *parameters, int stride, real dt, real *kept, int kept_stride,
                                        real *room);

#endif
