/* The likelihood of a noise model by the Kalman filter of a random walk. */
#include "likelihood.h"

#include "real.h"

double hystmpc_walk_likelihood(const double *residuals, const double *travel, int samples, double drift, double motion,
                               double *sensor) {
    double disturbance = 0.0, variance = 1.0, squares = 0.0, logs = 0.0;
    int count = 0;
    for (int k = 0; k < samples; k++) {
        if (travel[k] < 0.0) { /* the first residual of a trial only gives the start of the walk */
            disturbance = residuals[k], variance = 1.0;
            continue;
        }
        variance += drift + motion * travel[k];
        const double spread = variance + 1.0, error = residuals[k] - disturbance;
        squares += error * error / spread;
        logs += log(spread);
        disturbance += variance / spread * error;
        variance /= spread;
        count++;
    }
    sensor[0] = most(squares / count, 1e-16);
    return count * log(sensor[0]) + logs;
}
