/* The problem's numbers as the engine's functions take them. */
#include "internal.h"

static const real tracking[HYSTMPC_HORIZON] = HYSTMPC_TRACKING;
#if HYSTMPC_BLOCKS
static const int block_starts[HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_STARTS;
static const int block_ends[HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_ENDS;
static const real blocking[HYSTMPC_HORIZON * HYSTMPC_BLOCKS] = HYSTMPC_BLOCKING;
static const real block_constant[HYSTMPC_BLOCKS * HYSTMPC_BLOCKS] = HYSTMPC_BLOCK_CONSTANT;
#endif

HYSTMPC_SHARED const hystmpc_law hystmpc_weighs = {HYSTMPC_HORIZON,
                                                   HYSTMPC_BLOCKS ? HYSTMPC_BLOCKS : HYSTMPC_HORIZON,
                                                   HYSTMPC_BLOCKS > 0,
                                                   HYSTMPC_SOFT,
                                                   HYSTMPC_LOWER,
                                                   HYSTMPC_UPPER,
                                                   HYSTMPC_REACH,
                                                   HYSTMPC_RATE_WEIGHT,
                                                   HYSTMPC_EFFORT_WEIGHT,
                                                   HYSTMPC_SOFT_WEIGHT,
                                                   tracking,
#if HYSTMPC_BLOCKS
                                                   block_starts,
                                                   block_ends,
                                                   blocking,
                                                   block_constant
#else
                                                   0,
                                                   0,
                                                   0,
                                                   0
#endif
};

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
