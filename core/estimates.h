/* Between observer.c and frames.c: one estimate as a block of bytes, and its updates. */
#ifndef HYSTMPC_ESTIMATES_H
#define HYSTMPC_ESTIMATES_H

#include "observer.h"

/* Numbers of an estimate: of the state x, of the queue of angles (D + 1), of the bank (3 M), of the angles without the
 * learned part (D + 1, or none). */
typedef struct {
    int states, angles, bank, alone;
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

/* Time update of the disturbance alone, by the travel of the sample that led to the angle of now. */
HYSTMPC_LOCAL void hystmpc_disturbance_advance(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e);

/* Time update with the command u and what `hystmpc_next_of_model` answers; without a next state the model has failed. */
HYSTMPC_LOCAL void hystmpc_estimate_advance(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                            real u, const real *next, real angle);

/* How far the disturbance is believed, from 0 to 1: where the model is close, with the probability c, only as far as the
 * bank's mean m has foretold the offsets z of the last seconds,
 *
 *     1 - (1 - (1 - c)^2) (1 - s),   s = sum_j m_j z_j / (sum_j m_j^2 + doubt * sensor^2),   0 <= s <= 1
 *
 * s is the share of least error; a correction that only follows noise vanishes. A device that has changed is followed at
 * once. Frames are few: they are believed as far as s, whether the model is close or not. */
HYSTMPC_LOCAL real hystmpc_believed(const hystmpc_sensing *s, const hystmpc_estimate *e);

/* frames.c: the updates of an observer of frames, with its past. */
HYSTMPC_LOCAL void hystmpc_frames_init(hystmpc_observed *o, real y);
HYSTMPC_LOCAL void hystmpc_frames_correct(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_estimate *e,
                                          real y);
HYSTMPC_LOCAL int hystmpc_frames_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                              real y, real age);

/* What the oldest instant teaches before it is forgotten, and what that changes at all later ones; work of
 * `hystmpc_numbers_past` numbers and the angles. */
HYSTMPC_LOCAL void hystmpc_frames_teach(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                        real *work);
HYSTMPC_LOCAL void hystmpc_frames_keep(const hystmpc_sensing *s, const hystmpc_extent *n, hystmpc_observed *o);

#endif
