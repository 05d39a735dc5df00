/* Planners: a start plan improved by linearisation and a quadratic program, or by random plans. The result never costs
 * more than the start plan. */
#ifndef HYSTMPC_PLANNER_H
#define HYSTMPC_PLANNER_H

#include "law.h"
#include "model.h"

#include <stdint.h>

enum {
    HYSTMPC_LINEARISED = 0,    /* sequential quadratic programming, the program solved by qp.c */
    HYSTMPC_SOLVED = 1,        /* the same, the program solved by Python */
    HYSTMPC_PATH_INTEGRAL = 2, /* Williams et al., T-RO 2018, eq. (30) */
    HYSTMPC_CROSS_ENTROPY = 3  /* Pinneri et al., CoRL 2020, algorithm 1 */
};

/* Distribution of random plans u = p + sigma M F w, w standard normal; see random_plans.c. */
typedef struct {
    int samples;         /* N */
    int size;            /* m: normals of a plan */
    int elites;          /* of the cross-entropy method */
    int kept;            /* elites that take part in the next iteration again */
    uint64_t seed[2];    /* key of the random numbers, see normals.h */
    real temperature;    /* of the path integral */
    real sigma;          /* of the cross-entropy method: first deviation */
    real least_sigma;    /* and its least */
    const real *sigmas;  /* of the path integral: deviation of each plan (N) */
    const real *shape;   /* M F, transposed (m, H) */
    const real *whitening; /* F^-1, transposed (m, m) */
    const hystmpc_law *fitted; /* law of the fitted step, with its blocks */
} hystmpc_sampling;

typedef struct {
    int kind;
    int iterations;
    int close_iterations;             /* where the model is close to the device: its plan is worth finishing */
    int changes;                      /* of the active set in one program */
    const hystmpc_law *law;           /* limits, weights and blocks */
    const hystmpc_sampling *sampling; /* null unless plans are random */
    /* HYSTMPC_SOLVED: the plan (H) after the solution of the program around a plan, and its foreseen cost behind it; 0,
     * 1 where the iterations ran out, or as `hystmpc_step_plan`. */
    int (*solve)(const real *reference, const real *feedforward, const real *scalars, const real *jacobian,
                 const real *commands, const real *angles, real *out);
} hystmpc_planner;

/* A plan (H), its angles (H) by the model and its cost. */
typedef struct {
    real *commands, *angles;
    real cost;
} hystmpc_plan;

/* Why there is no plan, besides what qp.h and law.h say. */
enum { HYSTMPC_NO_SAMPLE = -7, HYSTMPC_NO_PREDICTION = -8, HYSTMPC_NO_ANSWER = -9 /* from outside */ };

/* Room for one improvement, that of the model's functions included; a `hystmpc_planner` and a `hystmpc_model`. */
HYSTMPC_API long hystmpc_planner_bytes(const void *planner, const void *model);

/* Improve the `hystmpc_plan` best in place from the state x, for a `hystmpc_task`; `draws` counts the steps of a random
 * planner. 0, 1 where iterations ran out and the best step was used, or a negative number that says why there is none:
 * then the plan is one that costs no more than at the start, and `draws` is as before. */
HYSTMPC_API int hystmpc_improve(const void *planner, const void *model, const real *x, const void *task, void *best,
                                int64_t *draws, char *room);

/* The same for random planners, in random_plans.c. */
HYSTMPC_LOCAL long hystmpc_random_bytes(const hystmpc_planner *p, const hystmpc_model *m);
HYSTMPC_LOCAL int hystmpc_improve_at_random(const hystmpc_planner *p, const hystmpc_model *m, const real *x,
                                            const hystmpc_task *task, hystmpc_plan *best, int64_t *draws, char *room);

#endif
