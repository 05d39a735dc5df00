/* A control law inside an observer, a chain of fallbacks and hard limits: a step never fails, and its commands never leave
 * the limits on value and rate.
 *
 * Order of one step: correct the estimate with the measurement, check the reference, let the law propose, take the
 * proposal or a fallback, limit from the command really sent, advance the model with the result.
 *
 * A problem is a tree of constant structs. A memory is one block of bytes without pointers, `hystmpc_memory_bytes` of a
 * problem: a copy of it is a snapshot, which another machine can take up. Room is for one call, nothing in it is
 * remembered. A memory that no init has accepted stands still: every function may be called on it. */
#ifndef HYSTMPC_CONTROLLER_H
#define HYSTMPC_CONTROLLER_H

#include "observer.h"
#include "planner.h"

/* The level of fallback that produced a command, best first. */
enum {
    HYSTMPC_MPC = 0,          /* the predictive law */
    HYSTMPC_FEEDBACK = 1,     /* feedforward or feedback */
    HYSTMPC_SHIFTED_PLAN = 2, /* what is left of the last good plan */
    HYSTMPC_INVERSE = 3,      /* the model's inverse */
    HYSTMPC_HOLD = 4,         /* the last command */
    HYSTMPC_STOP = 5          /* the safe command, or the last one; latched until an init accepts a start */
};

/* Why a better level was not used. */
enum {
    HYSTMPC_OK = 0,
    HYSTMPC_LATCHED = 1,       /* the stop is latched, or nothing has been started */
    HYSTMPC_BAD_REFERENCE = 2, /* not finite, or absurdly large */
    HYSTMPC_NO_SENSOR_NOW = 3, /* no usable measurement for too long */
    HYSTMPC_STALE_MODEL = 4,   /* the model could not be advanced */
    HYSTMPC_NO_PLAN = 5,       /* prediction, Jacobian or quadratic program not finite */
    HYSTMPC_NO_SOLUTION = 6,   /* the quadratic program was not solved */
    HYSTMPC_NO_COMMAND = 7,    /* the law's answer is not finite */
    HYSTMPC_NO_TIME = 8,       /* the caller has no time for a plan, see hystmpc_controller_hurry */
    HYSTMPC_FAILED = 9         /* a function from outside has failed */
};

/* Hold at a constant reference, see `HoldSettings` in ctrl/mpc_settings.py. */
typedef struct {
    real tolerance;  /* [deg] */
    real close_tolerance; /* the same where the model is as close to the device as its file says [deg] */
    real worth;      /* nearer by this: worth to leave a hold for before the reference moves [deg] */
    real step;       /* resolution of the sensor [deg] */
    real sigmas;     /* standard deviations of the disturbance at which a hold is left */
    int patience;    /* samples, at least 1 */
    int settle_after, settle;
} hystmpc_hold;

/* PID: kp e + I - kd dy/dt, I' = ki e + (u_limited - u) / tracking_s. */
typedef struct {
    real kp, ki, kd;
    real filter_s, tracking_s;
    real dead_zone;  /* errors below this are not integrated [deg] */
} hystmpc_gains;

enum {
    HYSTMPC_PREDICTIVE = 0,
    HYSTMPC_FEEDFORWARD = 1,     /* the inverse, sample by sample or over a preview */
    HYSTMPC_FEEDFORWARD_PID = 2, /* the same with PID feedback */
    HYSTMPC_PID = 3,
    HYSTMPC_PROPOSED = 4         /* by a law written in Python */
};

/* What a law is given; angles in deg. */
typedef struct {
    const real *state;      /* from which predictions start, `hystmpc_model_states` numbers */
    const real *reference;  /* at the ends of the samples that the next commands act in (H) */
    const real *remaining;  /* of the last plan (planned) */
    int planned;
    real disturbance;
    real sigma;             /* standard deviation of what noise does to the disturbance in a hold */
    real close;             /* probability that the model is as close to the device as its file says */
    real measured;          /* last accepted measurement */
    real age;               /* of that [samples] */
    real u_last;            /* the command really sent last */
    real due;               /* reference now */
    real setpoint;          /* reference at the end of this sample */
    real forecast_error;
} hystmpc_given;

/* What a law proposes: a command, and the plan behind it (planned) with its angles, without disturbance. */
typedef struct {
    real u;
    int source, status; /* HYSTMPC_MPC ..., HYSTMPC_OK ... */
    int fault;          /* of a planner, what planner.h says; 1 where its iterations ran out */
    int planned;
    int inverse;        /* of the fallback: 1 where the inverse answers no finite command, 2 where it has failed */
    real *commands, *angles;
} hystmpc_proposal;

typedef struct {
    int kind;
    int horizon;                     /* H: reference samples that the law uses */
    int supervised;                  /* whether the error of the forecasts chooses between three laws */
    real inverse_pid_above, pid_above; /* errors of the forecasts from which the two others take over */
    const hystmpc_planner *planner;  /* of the predictive law; of a feedforward over a preview; else null */
    int candidates;                  /* greatest number of candidate plans of that planner */
    int spare;
    real rate_weight;                /* on moves of the command */
    real close_rate_weight;          /* the same where the model is as close to the device as its file says */
    real angle_low, angle_high;      /* soft limits [deg] */
    real slope;                      /* static gain of the model [deg per command unit], 0: unknown */
    const hystmpc_hold *hold;        /* of the predictive law */
    const hystmpc_gains *gains;      /* null where nothing is fed back */
    real dead_zone;                  /* change of the reference that a feedforward does not follow [deg] */
    int (*propose)(const hystmpc_given *given, hystmpc_proposal *proposal); /* of a law written in Python */
} hystmpc_control_law;

typedef struct {
    real dt_s;
    real lower, upper; /* of the command */
    real reach;        /* its greatest change in a sample */
    real safe;         /* where a stop goes; not-a-number: it stays */
    int stop_after;    /* failed samples in succession after which the stop is latched */
    int most_missing;  /* samples without a usable measurement that are bridged by prediction */
    int falls_back_on_inverse;
    int spare;
    const hystmpc_model *model; /* null: none */
    const hystmpc_sensing *sensing;
    const hystmpc_control_law *law;
} hystmpc_problem;

/* Head of a memory. The estimate and the arrays stand behind it. */
typedef struct {
    int mark;               /* HYSTMPC_MARK once a start has been accepted */
    int failures, stopped, hurried;
    int planned;            /* entries left of the last good plan */
    int holding, constant;  /* of the hold: whether, and samples of constant reference */
    int level;              /* of the supervisor: 0 predictive, 1 feedforward and PID, 2 PID */
    int fed;                /* entries left of the feedforward's plan */
    int dues;               /* angles known that were due in the last samples */
    int64_t draws;          /* steps of a random planner */
    real due;               /* angle that is wanted at the present instant */
    real target;            /* of a step without a reference */
    real hold_target;
    real crept;             /* way of the model's angle since a hold began [deg] */
    real followed;          /* reference that the feedforward follows */
    real u_alone;           /* its last command */
    real error, integral, speed, angle, age; /* of the PID */
} hystmpc_head;

/* Answer of a step. */
typedef struct {
    real u;             /* always finite and within the limits */
    real predicted_deg; /* angle expected at the end of this sample, disturbance included; not-a-number where nothing has
                           been started or there is no model */
    real departure_deg; /* by how much the device is off the model as it was given, as estimated */
    int source;         /* HYSTMPC_MPC ... HYSTMPC_STOP */
    int status;         /* HYSTMPC_OK ... HYSTMPC_FAILED */
    int fault;          /* of a planner, see hystmpc_proposal */
    int missing;        /* samples since the last accepted measurement */
    int planned;        /* entries of the plan */
    int inverse;        /* of the fallback, see hystmpc_proposal */
} hystmpc_command;

HYSTMPC_API long hystmpc_memory_bytes(const void *problem);
HYSTMPC_API long hystmpc_room_bytes(const void *problem);

/* Reference samples that a step uses: those of the law, and those that pass before a command acts. */
HYSTMPC_API int hystmpc_reference_samples(const void *problem);

/* At rest at a measured angle [deg] under the command that the device holds, the predictor in the state x (S) at rest.
 * The target is that angle. 0, or why there is no start (observer.h). A start that is refused latches the stop. */
HYSTMPC_API int hystmpc_controller_init(const void *problem, char *memory, const real *x, real angle_deg,
                                        real command, char *room);

/* One sample; 0, or 1 where anything was unusual. `reference`: wanted angles [deg] at the ends of this and the next
 * samples; null for the target in all of them. plan: null, or room for the plan (H), then for the angles expected at
 * the ends of this and the next samples, disturbance included: as many as are planned, else D + 1 of commands that are
 * sent. */
HYSTMPC_API int hystmpc_controller_step(const void *problem, char *memory, real angle_deg, const real *reference,
                                        void *command, real *plan, char *room);

/* The angle [deg] wanted from the next step on, where no reference is given. */
HYSTMPC_API void hystmpc_controller_target(const void *problem, char *memory, real angle_deg);

/* The present value of a measured input (a pressure, a load), into an entry of the model's state: it holds until the next
 * one. 1, or 0 where it is no finite number, there is no such entry, or nothing has been started: then nothing changes. */
HYSTMPC_API int hystmpc_controller_input(const void *problem, char *memory, int entry, real value);

/* Measurement update with an angle [deg] taken `age` samples before the next step; 0 where it cannot be used. */
HYSTMPC_API int hystmpc_controller_measure(const void *problem, char *memory, real angle_deg, real age);

/* One sample in which another has sent `command`: the controller looks on, and knows the hysteresis when it takes over.
 * Answers for how many samples the model has failed, 0 where it has not, 1 where nothing has been started. */
HYSTMPC_API int hystmpc_controller_look_on(const void *problem, char *memory, real angle_deg, real command,
                                           char *room);

/* The command that the device holds, in place of the one sent last. */
HYSTMPC_API void hystmpc_controller_held(const void *problem, char *memory, real command);

/* The next step makes no plan, and is answered by the fallbacks. */
HYSTMPC_API void hystmpc_controller_hurry(const void *problem, char *memory);

/* Latch the stop: every further step goes towards the safe command, or stays. Only an init releases it. */
HYSTMPC_API void hystmpc_controller_stop(const void *problem, char *memory);

/* What an estimate in a memory holds: numbers (16) command, disturbance, variance, measured, age, added, forecast_error,
 * sigma, due, missing, stalled, failures, stopped, level, holding, constant; x (states of the model), angles, moves,
 * responsive (D + 1), bank (3, M); what is null is left out. */
HYSTMPC_API void hystmpc_controller_look(const void *problem, const char *memory, real *numbers, real *x, real *angles,
                                         real *moves, real *responsive, real *bank);

/* Between the files of the controller and of loop.c. */
enum { HYSTMPC_MARK = 0x48595354 }; /* which nothing else leaves in memory by chance */

/* Parts of a memory. */
typedef struct {
    hystmpc_head *head;
    hystmpc_observed observed;
    real *plan, *predicted; /* (H) what is left of the last good plan, and its angles */
    real *fed;              /* (H) what is left of the feedforward's plan */
    real *alone;            /* model state under the feedforward alone */
    real *due;              /* (oldest + 1) angles that were due, the newest last */
} hystmpc_memory;

/* Parts of a memory; counts that a foreign memory may have wrong are kept within them. */
HYSTMPC_LOCAL void hystmpc_memory_at(const hystmpc_problem *p, char *memory, hystmpc_memory *m);

/* A step in two halves, between which the axes of a device agree on what is sent, see axes.h. The first half: estimate and
 * proposal, 0 where nothing has been started. The second: what is sent and the answer of a step; `foretells`: whether the
 * proposal's angles become those of the answer, disturbance included. The proposal begins as zeros, with its arrays. */
HYSTMPC_LOCAL int hystmpc_controller_begin(const hystmpc_problem *p, hystmpc_memory *m, real angle_deg,
                                           const real *reference, hystmpc_proposal *out, char *room);
HYSTMPC_LOCAL int hystmpc_controller_finish(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_proposal *out,
                                            int foretells, hystmpc_command *answer, char *room);

HYSTMPC_LOCAL real hystmpc_within_limits(const hystmpc_problem *p, real u, real last);

/* The laws: memory as if nothing had been done, from rest at y under u in the state x; the proposal of one sample. A law
 * that fails leaves the head as it was. */
HYSTMPC_LOCAL long hystmpc_law_room(const hystmpc_problem *p);
HYSTMPC_LOCAL void hystmpc_forget_law(const hystmpc_problem *p, hystmpc_memory *m, const real *x, real y, real u);
HYSTMPC_LOCAL void hystmpc_propose(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g,
                                   hystmpc_proposal *out, char *room);

/* predictive.c */
HYSTMPC_LOCAL long hystmpc_predictive_room(const hystmpc_problem *p);
HYSTMPC_LOCAL void hystmpc_propose_plan(const hystmpc_problem *p, hystmpc_head *head, const hystmpc_given *g,
                                        hystmpc_proposal *out, char *room);
/* A plan along wanted angles (H) without disturbance: held where the held command stays within the tolerance. */
HYSTMPC_LOCAL int hystmpc_plan_ahead(const hystmpc_problem *p, const real *x, const real *wanted, real u_last,
                                     const real *remaining, int left, real tolerance, hystmpc_plan *best, char *room);

#endif
