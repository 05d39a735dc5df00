/* What a controller remembers of a learned part. The caller of an exported controller sees it in its header. */
#ifndef HYSTMPC_LEARNED_STATE_H
#define HYSTMPC_LEARNED_STATE_H

/* The basis: delays of 0 to 5 samples, first-order lags, plays of the travel behind them, dead zones, plays that also
 * count times the travel, slow followers; so many numbers are remembered behind a lag. */
#define HYSTMPC_DELAYS 6
#define HYSTMPC_LAGS 8
#define HYSTMPC_PLAYS 5
#define HYSTMPC_ZONES 8
#define HYSTMPC_WEIGHTED 4
#define HYSTMPC_CREEPS 2
#define HYSTMPC_MEMORY 8 /* travel, plays, slow followers */

#define HYSTMPC_FEATURES 21  /* travel, plays, zones, weighted plays, slow followers, rate */
#define HYSTMPC_WEIGHTS 22   /* gain, then one a feature */
#define HYSTMPC_UNKNOWNS 23  /* offset before them */
#define HYSTMPC_TRIANGLE 276 /* of a covariance of them, its lower half row by row */
#define HYSTMPC_LIKELY 46    /* two changes of all unknowns */
#define HYSTMPC_DRIVES 48    /* lags times delays */

/* A learned part that stands still: predictions start from it. Commands are shares of their range. */
typedef struct {
    hystmpc_real memory[HYSTMPC_MEMORY];   /* travel, plays, slow followers behind the drive */
    hystmpc_real queue[HYSTMPC_DELAYS];    /* commands, the newest first */
    hystmpc_real weights[HYSTMPC_WEIGHTS];
    hystmpc_real start[3];                 /* where the device started: travel, side, model angle */
    hystmpc_real share;                    /* of the way that the lag goes in a sample */
    hystmpc_real delay;                    /* whole samples */
} hystmpc_learned;

/* Kalman filters of the weights, one a drive, the lags side by side; and what their forecasts are worth. Drive
 * number lag * HYSTMPC_DELAYS + delay. Two scores come behind those of the drives: of the model alone, of the last
 * angle held. */
typedef struct {
    hystmpc_real z[HYSTMPC_DELAYS][HYSTMPC_UNKNOWNS][HYSTMPC_LAGS];
    hystmpc_real covariance[HYSTMPC_DELAYS][HYSTMPC_TRIANGLE][HYSTMPC_LAGS];
    hystmpc_real frozen[HYSTMPC_DELAYS][HYSTMPC_UNKNOWNS][HYSTMPC_LAGS]; /* z at the beginning of the block */
    hystmpc_real references[2];              /* at the same instant: the model's disturbance, the measured angle */
    hystmpc_real sums[HYSTMPC_DRIVES + 2];   /* squared errors of the forecasts in this block [deg^2] */
    hystmpc_real scores[HYSTMPC_DRIVES + 2]; /* their means over the past blocks with motion [deg^2] */
    hystmpc_real forecast_error;             /* of the better forecast over that of none, 0 to 1.2 */
    hystmpc_real share;                      /* with which the best drive acts, 0 to 1 */
    hystmpc_real waited;                     /* samples without a measurement since the last one that was used */
    hystmpc_real travelled;                  /* way of the command in them, as a share of the range */
    int count;                               /* samples in this block */
    int blocks;                              /* with motion so far */
    int best;                                /* drive */
} hystmpc_filters;

#endif
