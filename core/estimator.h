/* The disturbance of a model's angle, by a bank of Kalman filters of different noise levels. */
#ifndef HYSTMPC_ESTIMATOR_H
#define HYSTMPC_ESTIMATOR_H

#include "hystmpc_core.h"
#include "real.h"

/* Grid of M = sensors x drifts x motions filters, the motions in the innermost place, with variances in deg^2. */
typedef struct {
    int sensors, drifts, motions;
    const real *sensor_variances; /* of a measurement (sensors) */
    const real *drift_variances;  /* of a walk in a sample (drifts, motions) */
    const real *motion_variances; /* of a walk over one unit of command travel (drifts, motions) */
    const real *by_sensor;        /* probability of each sensor before anything was seen (sensors) */
    const real *by_model;         /* the same of drift and motion (drifts, motions) */
    const real *first_variances;  /* of the disturbance at the start (drifts, motions) */
    const real *most_variances;   /* s^2, of the disturbance at any time (drifts, motions) */
    int close;                    /* drifts at the end of the grid whose walk returns to zero: the model is close */
    int spare;
    real switching;               /* probability that the model's error changes in a sample */
    real most_gain;               /* of a filter */
    real limit;                   /* of the disturbance [deg] */
} hystmpc_noise;

/* In all of them `bank` (3, M) holds disturbance [deg], variance [deg^2] and weight of every filter; they answer the
 * variance of the disturbance [deg^2]. */

/* The bank at rest; where the model is close, the disturbance is zero until measurements say otherwise. */
HYSTMPC_LOCAL real hystmpc_noise_init(const hystmpc_noise *n, real *bank, real disturbance);

/* With a measurement used, `offset` = y - model [deg]; the disturbance [deg] is put into `mean`. */
HYSTMPC_LOCAL real hystmpc_noise_correct(const hystmpc_noise *n, real *bank, real offset, real *mean);

/* One sample later, the command having gone so far; the variance is that about `mean`. */
HYSTMPC_LOCAL real hystmpc_noise_advance(const hystmpc_noise *n, real *bank, real travel, real mean);

/* Probability of the filters in which the model is close to the device. */
HYSTMPC_LOCAL real hystmpc_noise_close(const hystmpc_noise *n, const real *bank);

/* The disturbance [deg]; variance of the sensor, the geometric mean over the filters, `logs` those of their variances (M). */
HYSTMPC_LOCAL real hystmpc_noise_mean(const hystmpc_noise *n, const real *bank);
HYSTMPC_LOCAL real hystmpc_noise_sensor(const hystmpc_noise *n, const real *bank, const real *logs);

#endif
