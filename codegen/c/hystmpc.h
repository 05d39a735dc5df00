/* Predictive controller of one device with hysteresis, exported by hystmpc. C99; no heap, no global state.
 *
 *   hystmpc_controller *c = &storage;           about hystmpc_memory_bytes() bytes, static or in a struct of yours
 *   hystmpc_init(c, angle_deg, held_command);   0, or why it cannot start
 *   hystmpc_set_target(c, 50.0);                a constant reference from the next step on
 *   for (;;) {                                  once every HYSTMPC_SAMPLE_S seconds
 *       hystmpc_command next = hystmpc_step(c, measured_deg, NULL);
 *       send(next.u);
 *   }
 *
 * A step never fails: it answers any measurement (not-a-number: none) and any reference with a finite command within
 * the limits on value and rate. The struct is the whole memory: a copy of it is a snapshot. Memory that no init has
 * accepted, zeroed or not, is a controller that stands still: every function may be called on it.
 */
#ifndef HYSTMPC_H
#define HYSTMPC_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "hystmpc: compiled for finite numbers only, which voids every check for not-a-number: leave out -ffast-math"
#endif

#include "hystmpc_problem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The level of fallback that produced a command, best first. */
enum {
    HYSTMPC_MPC = 0,          /* the predictive law */
    HYSTMPC_FEEDBACK = 1,     /* feedback has taken over from a model that foretells nothing */
    HYSTMPC_SHIFTED_PLAN = 2, /* what is left of the last good plan */
    HYSTMPC_INVERSE = 3,      /* the model's inverse */
    HYSTMPC_HOLD = 4,         /* the last command */
    HYSTMPC_STOP = 5          /* the safe command, or the last one; latched until hystmpc_init accepts a start */
};

/* Why a better level was not used. */
enum {
    HYSTMPC_OK = 0,
    HYSTMPC_LATCHED = 1,       /* the stop is latched, or nothing has been started */
    HYSTMPC_BAD_REFERENCE = 2, /* not finite, or absurdly large */
    HYSTMPC_NO_SENSOR = 3,     /* no usable measurement for too long */
    HYSTMPC_STALE_MODEL = 4,   /* the model could not be advanced */
    HYSTMPC_NO_PLAN = 5,       /* prediction, Jacobian or quadratic program not finite */
    HYSTMPC_NO_SOLUTION = 6,   /* the quadratic program was not solved */
    HYSTMPC_NO_COMMAND = 7,    /* the law's answer is not finite */
    HYSTMPC_NO_TIME = 8        /* the caller has no time for a plan, see hystmpc_hurry */
};

/* Answers of hystmpc_init. */
enum {
    HYSTMPC_STARTED = 0,
    HYSTMPC_BAD_ANGLE = 1,   /* not finite, or absurdly large */
    HYSTMPC_BAD_COMMAND = 2, /* beyond the limits */
    HYSTMPC_NOT_AT_REST = 3  /* further from the model at rest than estimator.rest_tolerance_deg */
};

typedef struct {
    hystmpc_real u;             /* command, always finite and within the limits */
    hystmpc_real predicted_deg; /* angle expected at the end of this sample, disturbance included; not-a-number
                                   where nothing has been started */
    hystmpc_real departure_deg; /* by how much the device is off the model as it was given, as estimated */
    int source;                 /* HYSTMPC_MPC ... HYSTMPC_STOP */
    int status;                 /* HYSTMPC_OK ... HYSTMPC_NO_COMMAND */
    int missing;                /* samples since the last accepted measurement */
} hystmpc_command;

#if HYSTMPC_LEARNS
#include "learned_state.h"
#endif

/* The model's memory, and that of what is learned on top of it. */
typedef struct {
    hystmpc_real model[HYSTMPC_STATES];
#if HYSTMPC_LEARNS
    hystmpc_learned learned;
    int acts;                                 /* whether any of its weights is not zero */
#endif
} hystmpc_state;

/* What is known of the device: model state, angles under way, disturbance. */
typedef struct {
    hystmpc_real model[HYSTMPC_STATES];
    hystmpc_real command;                     /* sent last */
    hystmpc_real angles[HYSTMPC_UNDER_WAY];   /* predicted, without disturbance: now, then of commands under way */
    hystmpc_real moves[HYSTMPC_UNDER_WAY];    /* command travel that led to each of them */
    hystmpc_real disturbance;
    hystmpc_real variance;
    hystmpc_real measured;                    /* last accepted measurement */
    hystmpc_real bank[3][HYSTMPC_FILTERS];    /* disturbance, variance, weight of every noise filter */
    int responsive[HYSTMPC_UNDER_WAY];        /* whether each angle answers to the command */
    int missing;
    int stalled;                              /* samples since the model was last advanced */
    int started;                              /* HYSTMPC_MARK once hystmpc_init has accepted a start */
} hystmpc_estimate;

#if HYSTMPC_LEARNS
/* What is learned on top of the model. */
typedef struct {
    hystmpc_filters filters;
    hystmpc_real past[HYSTMPC_PAST];          /* start, last commands, memories behind all lags */
    hystmpc_real added[HYSTMPC_UNDER_WAY];    /* to each of the model's angles */
} hystmpc_learning;
#endif

#if HYSTMPC_SUPERVISED
/* Memory of the two feedback laws. */
typedef struct {
    hystmpc_state alone;                      /* the model under the feedforward command alone */
    hystmpc_real u_alone;
    hystmpc_real followed;
    hystmpc_real error;
    hystmpc_real integral;
    hystmpc_real speed;
    hystmpc_real angle;
    hystmpc_real age;
    int level;                                /* 0 predictive, 1 inverse and PID, 2 PID */
} hystmpc_feedback;
#endif

/* Room for one step; nothing in it is remembered. */
typedef struct {
    hystmpc_real plans[HYSTMPC_CANDIDATES][HYSTMPC_HORIZON];
    hystmpc_real angles[HYSTMPC_CANDIDATES][HYSTMPC_HORIZON];
    hystmpc_real jacobian[HYSTMPC_HORIZON][HYSTMPC_HORIZON];
    hystmpc_real columns[HYSTMPC_QP_MOVES][HYSTMPC_QP_ROWS]; /* of the program's rows, then in its metric */
    hystmpc_real hessian[HYSTMPC_QP_MOVES][HYSTMPC_QP_MOVES];
    hystmpc_real factor[HYSTMPC_QP_SIZE][HYSTMPC_QP_SIZE];   /* of the active rows */
    hystmpc_real active[HYSTMPC_QP_SIZE][HYSTMPC_QP_MOVES];
    hystmpc_real gradient[HYSTMPC_QP_MOVES];
    hystmpc_real lower[HYSTMPC_QP_ROWS];
    hystmpc_real upper[HYSTMPC_QP_ROWS];
    hystmpc_real soft[HYSTMPC_QP_ROWS];       /* squared length that a row has by its own variable */
    int first[HYSTMPC_QP_MOVES];              /* row of each column that is not zero */
    hystmpc_real by_move[HYSTMPC_HORIZON][HYSTMPC_HORIZON];
    hystmpc_real normal[HYSTMPC_HORIZON][HYSTMPC_HORIZON];
    hystmpc_real moving[2][HYSTMPC_CHAIN + 9][HYSTMPC_HORIZON];
#if HYSTMPC_UNITS
    float network_rows[HYSTMPC_NETWORK_ROWS][HYSTMPC_NETWORK_WIDTH]; /* command and outputs, a row a plan or derivative */
    float network_cells[HYSTMPC_NETWORK_ROWS][HYSTMPC_NETWORK_CELLS];
    float network_outputs[HYSTMPC_NETWORK_ROWS][HYSTMPC_UNITS];
#endif
} hystmpc_work;

typedef struct {
    hystmpc_estimate estimate;
#if HYSTMPC_LEARNS
    hystmpc_estimate plain;                   /* of the model alone */
    hystmpc_learning learning;
#endif
#if HYSTMPC_SUPERVISED
    hystmpc_feedback feedback;
#endif
    hystmpc_real plan[HYSTMPC_HORIZON];       /* what is left of the last good plan, and its angles */
    hystmpc_real predicted[HYSTMPC_HORIZON];
    hystmpc_real due;                         /* the angle that was wanted at the present instant */
    hystmpc_real target;                      /* of a step without a reference */
    hystmpc_real hold_target;
    int holding;
    int constant;                             /* samples of constant reference */
    int planned;                              /* entries of plan */
    int failures;
    int stopped;
    int hurried;                              /* whether the next step makes no plan */
    hystmpc_work work;
} hystmpc_controller;

/* At rest at a measured angle [deg] under the command that the device holds. The target is that angle. A start that is
 * refused latches the stop: steps go on from the last command sent, or hold that of the refused start, or the admissible
 * one nearest to it, or the least where it is no number. */
int hystmpc_init(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command);

/* One sample. `reference` holds the wanted angles [deg] at the ends of this and the next samples,
 * HYSTMPC_REFERENCE of them; NULL for the target in all of them. */
hystmpc_command hystmpc_step(hystmpc_controller *c, hystmpc_real angle_deg, const hystmpc_real *reference);

/* The angle [deg] wanted from the next step on, where no reference is given. */
void hystmpc_set_target(hystmpc_controller *c, hystmpc_real angle_deg);

/* One sample in which another has sent `command`: the controller looks on, and knows the hysteresis when it takes over.
 * The next command is limited from that one: from the nearest within the limits, or from the last where it is no number.
 * Answers for how many samples the model has failed, 0 where it has not, 1 where nothing has been started. */
int hystmpc_look_on(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command);

/* The next step makes no plan, and is answered by the fallbacks: for a sample that begins too late. */
void hystmpc_hurry(hystmpc_controller *c);

/* Latch the stop: every further step goes towards the safe command, or stays. Only hystmpc_init releases it. */
void hystmpc_stop(hystmpc_controller *c);

/* sizeof(hystmpc_controller), for callers that cannot see the struct. */
unsigned long hystmpc_memory_bytes(void);

#ifdef __cplusplus
}
#endif
#endif
