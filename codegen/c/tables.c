/* The problem's numbers as the engine's functions take them. */
#include "internal.h"

#if HYSTMPC_SENSES

static const real sensor_variances[HYSTMPC_SENSORS] = HYSTMPC_SENSOR_VARIANCES;
static const real drift_variances[HYSTMPC_DRIFTS] = HYSTMPC_DRIFT_VARIANCES;
static const real motion_variances[HYSTMPC_MOTIONS] = HYSTMPC_MOTION_VARIANCES;
static const real by_sensor[HYSTMPC_SENSORS] = HYSTMPC_BY_SENSOR;
static const real by_model[HYSTMPC_DRIFTS * HYSTMPC_MOTIONS] = HYSTMPC_BY_MODEL;
static const real first_variances[HYSTMPC_DRIFTS * HYSTMPC_MOTIONS] = HYSTMPC_FIRST_VARIANCES;
static const real most_variances[HYSTMPC_DRIFTS * HYSTMPC_MOTIONS] = HYSTMPC_MOST_VARIANCES;

HYSTMPC_SHARED const hystmpc_noise hystmpc_noises = {HYSTMPC_SENSORS,
                                                     HYSTMPC_DRIFTS,
                                                     HYSTMPC_MOTIONS,
                                                     sensor_variances,
                                                     drift_variances,
                                                     motion_variances,
                                                     by_sensor,
                                                     by_model,
                                                     first_variances,
                                                     most_variances,
                                                     HYSTMPC_SWITCHING,
                                                     HYSTMPC_MOST_GAIN,
                                                     HYSTMPC_DISTURBANCE_LIMIT};

#endif

#if HYSTMPC_LEARNS

HYSTMPC_SHARED const hystmpc_learner hystmpc_learns = {
    {HYSTMPC_CREEP_SHARES, HYSTMPC_PACE, HYSTMPC_RANGE_LOW, HYSTMPC_RANGE_SPAN},
    HYSTMPC_LAG_SHARES,
    HYSTMPC_PRIOR,
    HYSTMPC_GROWTH,
    HYSTMPC_WALK,
    HYSTMPC_LEARNING_NOISE,
    HYSTMPC_FLOOR,
    HYSTMPC_SCALE,
    HYSTMPC_DELAY,
    HYSTMPC_BLOCK};

#endif
