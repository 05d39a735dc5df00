/* The model of a controller: a predictor, its inverse, and what is learned on top of it.
 *
 *     theta = m + w_c (m - m_0) + sum_i w_i f_i(v)                (basis.h)
 *
 * The state x is the predictor's, behind it the numbers of a `hystmpc_learned` where something is learned. Functions
 * answer as those of predictor.h. */
#ifndef HYSTMPC_MODEL_H
#define HYSTMPC_MODEL_H

#include "learning.h"
#include "predictor.h"

typedef struct {
    const hystmpc_predictor *predictor;
    const hystmpc_inverse *inverse;  /* null: none */
    const hystmpc_learner *learner;  /* null: nothing is learned */
} hystmpc_model;

/* Numbers of a state; bytes of room for so many rows of so many samples. */
HYSTMPC_API int hystmpc_model_states(const void *model);
HYSTMPC_API long hystmpc_model_bytes(const void *model, int rows, int samples);

/* Whether a weight of the learned part is not zero. */
HYSTMPC_API int hystmpc_model_acts(const void *model, const real *x);

/* As the functions of a predictor. */
HYSTMPC_API int hystmpc_model_advance(const void *model, real *x, real u, real *theta, char *room);
HYSTMPC_API int hystmpc_model_run(const void *model, const real *x, int rows, int samples, const real *plans,
                                  real *angles, char *room);
HYSTMPC_API int hystmpc_model_linearise(const void *model, const real *x, int samples, const real *plan, real *angles,
                                        real *jacobian, char *room);

/* The inverse at the angle less the learned part in a hold. */
HYSTMPC_API int hystmpc_model_command(const void *model, const real *x, real theta, real u_last, real *u, char *room);

/* Commands along the wanted angles as `hystmpc_inverse_follow`: at the angles less the learned part, first in a hold,
 * then twice along the plan found, a fixed point where the learned part is the smaller one. */
HYSTMPC_API int hystmpc_model_follow(const void *model, const real *x, const real *wanted, int samples, real u_last,
                                     const real *bounds, real *plans, char *room);

#endif
