/* Between observer.c and frames.c: one estimate as a block of bytes, and its updates. */
#ifndef HYSTMPC_ESTIMATES_H
#define HYSTMPC_ESTIMATES_H

#include "observer.h"

/* Numbers of an estimate: of the state x, of the queue of angles (D + 1), of the bank (3 M). */
typedef struct {
    int states, angles, bank;
} hystmpc_extent;

HYSTMPC_LOCAL hystmpc_extent hystmpc_extent_of(const hystmpc_sensing *s, const hystmpc_model *m);

/* Bytes of a block, a multiple of 8; its parts. */
HYSTMPC_LOCAL long hystmpc_estimate_bytes(const hystmpc_extent *n);
HYSTMPC_LOCAL hystmpc_estimate hystmpc_estimate_at(const hystmpc_extent *n, char *block);

/* Numbers for work in the room of a call, behind what the predictor works in. */
HYSTMPC_LOCAL real *hystmpc_observer_work(const hystmpc_model *m, char *room);

/* One sample of the model from x (S): the next state (S) and its angle; 0 where the model has failed, where they are not
 * finite, or the angle absurdly large. */
HYSTMPC_LOCAL int hystmpc_next_of_model(const hystmpc_model *m, const real *x, real u, real *next, real *angle,
                                        char *room);

/* Measurement update of model and disturbance; one that is missing or an outlier changes the count alone. */
HYSTMPC_LOCAL void hystmpc_estimate_correct(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                            real y);

/* Time update with the command u and what `hystmpc_next_of_model` answers; without a next state the model has failed. */
HYSTMPC_LOCAL void hystmpc_estimate_advance(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                            real u, const real *next, real angle);

/* frames.c: the updates of an observer of frames, with its past; a late frame needs as much room. */
HYSTMPC_LOCAL long hystmpc_frames_work(const hystmpc_sensing *s, const hystmpc_extent *n);
HYSTMPC_LOCAL void hystmpc_frames_init(hystmpc_observed *o, real y);
HYSTMPC_LOCAL void hystmpc_frames_correct(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                          real y);
HYSTMPC_LOCAL int hystmpc_frames_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                              real y, real age, char *room);
HYSTMPC_LOCAL void hystmpc_frames_keep(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_observed *o);

#endif
