/* The likelihood of a noise model, white noise of the sensor and a random walk: models/identify/estimation_noise.py. */
#ifndef HYSTMPC_LIKELIHOOD_H
#define HYSTMPC_LIKELIHOOD_H

#include "hystmpc_core.h"
#include "real.h"

/* Twice the negative log-likelihood of residuals (T,) [deg], without a constant; `sensor` (1,) is the sensor's variance
 * [deg^2]. With P and S in variances of the sensor (Harvey, 1989, section 3.4):
 *
 *     S = P + 1,  r = mean e^2 / S,  cost = n log r + sum log S
 *
 * `travel` (T,) is that of the command in the sample before each [command unit], below zero at the first sample of a
 * trial; drift and motion are the variance of the walk in a sample, and over one unit of travel. */
HYSTMPC_API real hystmpc_walk_likelihood(const real *residuals, const real *travel, int samples, real drift,
                                         real motion, real *sensor);

#endif
