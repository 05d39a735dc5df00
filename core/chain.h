/* Chains: operators in series (or wired otherwise), each a program; simulation, slopes, states at rest, inverse.
 *
 * A chain is a block of whole numbers and its constants:
 *
 *     stages, states, parameters, kept, signals, inputs, outputs, scheduled inputs, then the signals that are outputs
 *     9 a stage          where its table begins, where that of its state at rest (-1: none), first state, first parameter,
 *                        first kept value, first constant, constants of the step, constants of the state at rest, where
 *                        its wires begin: signals that it reads, signals that it writes
 *     wires, tables
 *
 * Signals 0 ... inputs - 1 are the inputs: nu commands, and behind them ns scheduled ones, which the device measures and
 * no controller decides (a pressure, a load). ny signals are outputs. One axis has nu, ny, ns = 1, 1, 0; stage k reads
 * signal k.
 *
 * Memory for a call is given by the caller: bytes by the function beside it. `kept` (K, N) are the values that parameters
 * and sample time alone decide, by hystmpc_chain_prepare. */
#ifndef HYSTMPC_CHAIN_H
#define HYSTMPC_CHAIN_H

#include "program.h"

/* kept (K, rows) by parameters (P, rows), the same sample time dt [s] in all rows; room for `registers` numbers. */
HYSTMPC_API void hystmpc_chain_prepare(const int *chain, const real *constants, const real *parameters, int rows,
                                       real dt, real *kept, real *room);

/* Bytes of memory for the functions below; directions: 0 where nothing is differentiated. */
HYSTMPC_API long hystmpc_chain_bytes(const int *chain, int rows, int directions);

/* Free run of N rows over T samples.
 *
 * u, y: entry j of sample t of row n at [j stride[0] + t stride[1] + n stride[2]], each with three strides.
 * x: state i of row n at [i stride[0] + n stride[1]]; overwritten by the state behind the last sample where `moves`.
 * known: scheduled inputs (ns, T), the same in all rows; null where they stand in u, behind the commands.
 * kept: (K, kept_rows), kept_rows = N, or 1 for the same parameters in all rows. */
HYSTMPC_API void hystmpc_chain_simulate(const int *chain, const real *kept, int kept_rows, int rows, int samples,
                                        const real *u, const int *u_stride, const real *known, real *x,
                                        const int *x_stride, int moves, real *y, const int *y_stride, char *memory);

/* Free runs of N rows laid end to end, with derivatives in D directions by forward sensitivity.
 *
 *     m' = (dg/dx) m + (dg/du) du + (dg/dp) s,    dy = (df/dx) m + (df/du) du + (df/dp) s
 *
 * first: (N + 1), run n has samples first[n] to first[n + 1].    u: (inputs, T).    du: (inputs, T, D), or null for zero.
 * seeds: s (P, D).    x: (S, N), m: (S, N, D), before the first sample.    y: (outputs, T).    dy: (outputs, T, D). */
HYSTMPC_API void hystmpc_chain_differentiate(const int *chain, const real *kept, int rows, const int *first,
                                             const real *u, const real *du, int directions, const real *seeds,
                                             const real *x, const real *m, real *y, real *dy, char *memory);

/* Outputs y (ny, H) along one plan (nu, H) and their derivatives dy (ny, H, nu, H) by its commands. `known` (ns, H): the
 * scheduled inputs. Where one is not a finite number, or they are left out (null), no result is a number. */
HYSTMPC_API void hystmpc_chain_linearise(const int *chain, const real *kept, const real *x, const real *plan,
                                         const real *known, int samples, real *y, real *dy, char *memory);
HYSTMPC_API long hystmpc_chain_linearise_bytes(const int *chain, int samples);

/* Outputs (N, ny, H) of plans (N, nu, H) from one state, the same scheduled inputs `known` (ns, H) for all, as above;
 * memory as for N rows. */
HYSTMPC_API void hystmpc_chain_roll_out(const int *chain, const real *kept, const real *x, int rows, int samples,
                                        const real *plans, const real *known, real *y, char *memory);

/* States at rest (S, N) of one stage and their derivatives m (S, N, D), at input u (N) and output seen (N) with
 * derivatives du and dseen (N, D); parameters (P, N) or (P, 1) of the stage, seeds (P, D); room for the registers and
 * the rows of its table at rest. */
HYSTMPC_API void hystmpc_chain_rest(const int *chain, const real *constants, int stage, int rows, const real *u,
                                    const real *du, const real *seen, const real *dseen, const real *parameters,
                                    int parameter_rows, int directions, const real *seeds, real *x, real *m, real *room);
HYSTMPC_API int hystmpc_chain_rest_room(const int *chain, int stage);

/* States x (S, N) at rest of a chain in series, of one input and one output, and their derivatives m (S, N, D), under the
 * commands u (N) with the output y (N), or the nearest one it can have. Every operator rests at the output of the one
 * before it, stage `core` at the angle for which the chain has that output one sample later. parameters (P), seeds (P, D);
 * memory as chain_settle_bytes. */
HYSTMPC_API void hystmpc_chain_settle(const int *chain, const real *constants, const real *kept, int core, int rows,
                                      const real *u, const real *y, const real *parameters, int directions,
                                      const real *seeds, real *x, real *m, char *memory);
HYSTMPC_API long hystmpc_chain_settle_bytes(const int *chain, int rows, int directions);

/* One sample of a chain with one input and one output: the angle; x (S) moves on. Memory for this and what follows:
 * hystmpc_chain_single_bytes. */
HYSTMPC_API real hystmpc_chain_step(const int *chain, const real *kept, real *x, real u, char *memory);
HYSTMPC_API long hystmpc_chain_single_bytes(const int *chain);

/* The command in [low, high] that brings the next angle to `wanted`, nearest to `last` on a flat branch; the angle does
 * not fall with the command. Newton's method on the exact derivative inside a shrinking bracket. */
HYSTMPC_API real hystmpc_chain_command_for(const int *chain, const real *kept, const real *x, real wanted, real low,
                                           real high, real last, char *memory);

#endif
