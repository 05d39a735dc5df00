/* What is known of the device: the model's state from the commands really sent, the disturbance of its output from the
 * measurements.
 *
 *     theta_k = model(commands up to k-1-D) + d_k,   d_{k+1} = d_k + w_k,   y_k = theta_k + v_k
 *
 * The model holds every command sent; the D angles of commands on their way stand in a queue, so that a measurement meets
 * the prediction made for its own instant. Outliers, and samples in which the command moved but the model did not, are
 * not integrated. */
#ifndef HYSTMPC_OBSERVER_H
#define HYSTMPC_OBSERVER_H

#include "estimator.h"
#include "model.h"

#define HYSTMPC_ANGLE_BOUND R(1e4)       /* [deg], far beyond any joint; keeps squares and sums of angles finite */
#define HYSTMPC_MOST_SAMPLES 1000000000  /* at which a count stays */

enum {
    HYSTMPC_CONTINUOUS = 0,   /* a measurement in every sample */
    HYSTMPC_FRAMES = 1,       /* now and then, and late: each is used at the instant at which it was taken */
    HYSTMPC_NO_SENSOR = 2,    /* the model alone */
    HYSTMPC_NEWEST = 3,       /* no model: the newest measurement of a continuous sensor */
    HYSTMPC_NEWEST_FRAME = 4  /* no model: the frame that was taken last */
};

enum { HYSTMPC_SEEN = 16 }; /* measurements of one instant that are remembered for late frames */

/* Numbers of an estimate; of a controller's memory, `whole` angles are those with the learned part. */
typedef struct {
    real command;     /* sent last */
    real disturbance; /* [deg] */
    real variance;    /* of its error [deg^2] */
    real measured;    /* last accepted measurement [deg] */
    real since;       /* share of a sample by which that is younger than `missing` samples */
    real forecast_error;
    real added;       /* learned part of the first angle [deg] */
    real earned[2];   /* sums of m z and m^2 [deg^2], m the mean of the bank before the offset z came */
    real seen[HYSTMPC_SEEN]; /* measurements of this instant, used or not usable [deg] */
    int count;        /* of them */
    int missing;      /* samples since the last accepted measurement */
    int stalled;      /* samples since the model was last advanced */
    int spare;
} hystmpc_known;

typedef struct {
    int sensor;
    int delay;             /* D: samples of delay that the model does not have */
    int oldest;            /* age of the oldest frame that is used [samples] */
    real outlier;          /* [deg] */
    real dead_band_gain;   /* slope below which the model is inside the dead band [deg per command unit] */
    real resolution;       /* travel below this counts as none [command unit] */
    real rest_tolerance;   /* [deg] */
    real forgets;          /* factor on the sums `earned` in a sample */
    real doubt;            /* prior doubt, as many measurements of pure noise */
    const real *logs;      /* logarithms of the filters' sensor variances (M); null: what is measured is believed */
    const hystmpc_noise *noise; /* null without a model or a sensor */
} hystmpc_sensing;

/* An estimate in a memory: one block of bytes without pointers. */
typedef struct {
    hystmpc_known *known;
    real *model;      /* x (S) of the predictor after every command sent */
    real *angles;     /* (D + 1) predicted, without disturbance: now, then of commands on their way [deg] */
    real *responsive; /* (D + 1) whether each angle answers to the command, 1 or 0 */
    real *moves;      /* (D + 1) command travel of the sample that led to each angle */
    real *bank;       /* (3, M) disturbance, variance, weight of every filter */
    real *alone;      /* (D + 1) `angles` without the learned part; only where frames teach it */
} hystmpc_estimate;

/* What is learned, in a memory. */
typedef struct {
    hystmpc_filters *filters;
    real *past;   /* learning.h */
    real *behind; /* the same at the oldest instant that is remembered; only where frames teach */
    real *added;  /* (D + 1) to each angle of the model [deg] */
} hystmpc_learning;

/* The memory of an observer. */
typedef struct {
    hystmpc_estimate now;   /* with the learned part; its `model` is not used where `alone` is */
    hystmpc_estimate alone; /* of the model alone; only where something is learned: of frames, a view of `now` */
    hystmpc_learning learning;
    char *past;             /* of frames: ring of (oldest) estimates of the last instants */
    int *instants;          /* written to it, less whole rounds of a full ring: 0 ... 2 oldest - 1 */
} hystmpc_observed;

/* Numbers of `past` in learning.h. */
HYSTMPC_LOCAL int hystmpc_numbers_past(const hystmpc_learner *n);

/* Bytes of the memory, a multiple of 8; its parts. */
HYSTMPC_LOCAL long hystmpc_observed_bytes(const hystmpc_sensing *s, const hystmpc_model *m);
HYSTMPC_LOCAL void hystmpc_observed_at(const hystmpc_sensing *s, const hystmpc_model *m, char *memory,
                                       hystmpc_observed *o);

/* Room for one call. */
HYSTMPC_LOCAL long hystmpc_observer_bytes(const hystmpc_sensing *s, const hystmpc_model *m);

enum {
    HYSTMPC_STARTED = 0,
    HYSTMPC_BAD_ANGLE = 1,   /* not finite, or absurdly large */
    HYSTMPC_BAD_COMMAND = 2, /* beyond the limits */
    HYSTMPC_NOT_AT_REST = 3  /* the model is further from the angle than the tolerance, or not finite */
};

/* At rest at the angle y under the held command u, the predictor in the state x (S) at rest. Nothing is written where the
 * start is refused. Without a sensor the model's angle counts as measured. The state x of an observer written in Python is
 * taken as it is, with y for its angles. Limits of the command are the caller's matter. */
HYSTMPC_LOCAL int hystmpc_observer_init(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                        const real *x, real y, real u, char *room);

/* The measured angle, or not-a-number where it is missing or absurdly large. */
HYSTMPC_LOCAL real hystmpc_usable_angle(real y);

/* One sample more; a count stays before it runs over. */
HYSTMPC_LOCAL int hystmpc_later(int samples);

/* The present value of a measured input, into an entry of the model's state, where it holds until the next one. 0 where it
 * is no finite number, or there is no such entry: then nothing changes. */
HYSTMPC_LOCAL int hystmpc_observer_input(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o, int entry,
                                         real value);

/* Measurement update with y; not-a-number and outliers change nothing but the count of what is missing. */
HYSTMPC_LOCAL void hystmpc_observer_correct(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                            real y);

/* The same with a measurement of `age` samples ago; 0 where it cannot be used. */
HYSTMPC_LOCAL int hystmpc_observer_correct_late(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                                real y, real age);

/* One sample later, u having been sent; where the model fails its state stands still. */
HYSTMPC_LOCAL void hystmpc_observer_advance(const hystmpc_sensing *s, const hystmpc_model *m, hystmpc_observed *o,
                                            real u, char *room);

/* The state (S, and the learned part) that predictions start from. */
HYSTMPC_LOCAL void hystmpc_observer_state(const hystmpc_sensing *s, const hystmpc_model *m, const hystmpc_observed *o,
                                          real *x);

/* Age of the last accepted measurement [samples]; standard deviation of what noise does to the disturbance [deg]. */
HYSTMPC_LOCAL real hystmpc_observer_age(const hystmpc_observed *o);
HYSTMPC_LOCAL real hystmpc_observer_sigma(const hystmpc_sensing *s, const hystmpc_observed *o);

/* Probability that the model is as close to the device as its file says; 1 without a sensor. */
HYSTMPC_LOCAL real hystmpc_observer_close(const hystmpc_sensing *s, const hystmpc_observed *o);

/* The same for Python, which has the memory alone (observing.c); `model` may be null. */
HYSTMPC_API long hystmpc_observing_bytes(const void *sensing, const void *model);
HYSTMPC_API long hystmpc_observing_room(const void *sensing, const void *model);
HYSTMPC_API int hystmpc_observing_init(const void *sensing, const void *model, char *memory, const real *x, real y,
                                       real u, char *room);
HYSTMPC_API void hystmpc_observing_correct(const void *sensing, const void *model, char *memory, real y);
HYSTMPC_API int hystmpc_observing_correct_late(const void *sensing, const void *model, char *memory, real y, real age);
HYSTMPC_API void hystmpc_observing_advance(const void *sensing, const void *model, char *memory, real u, char *room);

/* numbers (10): command, disturbance, variance, measured, age, added, forecast_error, sigma, missing, stalled; the state
 * that predictions start from, angles, moves, responsive (D + 1), bank (3, M); what is null is left out. */
HYSTMPC_API void hystmpc_observing_look(const void *sensing, const void *model, const char *memory, real *numbers,
                                        real *x, real *angles, real *moves, real *responsive, real *bank);

#endif
