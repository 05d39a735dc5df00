/* Kalman filters that learn the weights of the basis, one for each drive of a grid, and their forecasts judged. */
#ifndef HYSTMPC_LEARNING_H
#define HYSTMPC_LEARNING_H

#include "basis.h"

/* What the filters know of a device. Angles in deg, variances in deg^2; z = (offset, gain w_c, weights). */
typedef struct {
    hystmpc_basis basis;
    real lags[HYSTMPC_LAGS];       /* way that the travel behind each lag goes in a sample, as a share */
    real prior[HYSTMPC_UNKNOWNS];  /* variances of z before anything was learned */
    real likely[HYSTMPC_LIKELY]; /* two changes of z that are likely as a whole, one behind the other */
    real growth[HYSTMPC_UNKNOWNS]; /* of them in a sample */
    real walk[HYSTMPC_UNKNOWNS];   /* of them over the whole range of commands */
    real noise;                    /* variance of a measurement */
    real floor;                    /* mean square below which no forecast has to come */
    real expected;                 /* part of a score that is noise of the measurements */
    real kept;                     /* forgetting factor of a score, a block */
    real gain;                     /* share of the model's score by which a forecast has to be better, to act */
    real scale;                    /* angle over the whole range */
    int delay;                     /* samples of delay that the estimator takes care of */
    int block;                     /* samples of a block of forecasts */
} hystmpc_learner;

/* What has acted on the basis, `past` in all functions: travel, side and model angle at the start (3), the last commands
 * as shares of the range, the newest first (DELAYS), and the memory behind each lag now and in the last samples, the
 * newest first (DELAYS + 1 + delay, MEMORY, LAGS). */

/* At rest under the command u, the model at `angle` and the measurement at `y`. */
HYSTMPC_LOCAL void hystmpc_learning_init(const hystmpc_learner *n, real *past, hystmpc_filters *l, real angle, real u,
                                         real y);

/* One sample later under the command u. */
HYSTMPC_LOCAL void hystmpc_learning_advance(const hystmpc_learner *n, real *past, real u);

/* A sample without a measurement. */
HYSTMPC_LOCAL void hystmpc_learning_wait(const hystmpc_learner *n, const real *past, hystmpc_filters *l);

/* With a measurement used: `angle` is the model's at that instant, `disturbance` its own before this measurement. */
HYSTMPC_LOCAL void hystmpc_learning_correct(const hystmpc_learner *n, const real *past, hystmpc_filters *l, real y,
                                            real angle, real disturbance);

/* How far the angle may have moved under the last commands: twice what the mean slope says. */
HYSTMPC_LOCAL real hystmpc_learning_reach(const hystmpc_learner *n, const real *past);

/* What the best drive adds to the model's angles (delay + 1), the last one under the newest command; both may be
 * one array. */
HYSTMPC_LOCAL void hystmpc_learning_added(const hystmpc_learner *n, const real *past, const hystmpc_filters *l,
                                          const real *angles, real *added);

/* The learned part that predictions start from. */
HYSTMPC_LOCAL void hystmpc_learning_state(const hystmpc_learner *n, const real *past, const hystmpc_filters *l,
                                          hystmpc_learned *s);

#endif
