/* The likelihood of a noise model by the Kalman filter of a random walk. */
#include "likelihood.h"

real hystmpc_walk_likelihood(const real *residuals, const real *travel, int samples, real drift, real motion,
                             real *sensor) {
    real disturbance = R(0.0), variance = R(1.0), squares = R(0.0), logs = R(0.0);
    int count = 0;
    for (int k = 0; k < samples; k++) {
        if (travel[k] < R(0.0)) { /* the first residual of a trial only gives the start of the walk */
            disturbance = residuals[k], variance = R(1.0);
            continue;
        }
        variance += drift + motion * travel[k];
        const real spread = variance + R(1.0), error = residuals[k] - disturbance;
        squares += error * error / spread;
        logs += MATH(log)(spread);
        disturbance += variance / spread * error;
        variance /= spread;
        count++;
    }
    sensor[0] = most(squares / (real)count, R(1e-16));
    return (real)count * MATH(log)(sensor[0]) + logs;
}
