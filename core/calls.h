/* What Python calls of estimator, basis and learning: one call a sample where the controller in C has several. Angles in
 * deg; the state before a call is copied by the caller where it is kept. */
#ifndef HYSTMPC_CALLS_H
#define HYSTMPC_CALLS_H

#include "estimator.h"
#include "hystmpc_core.h"
#include "learning.h"

/* A bank of noise filters, see estimator.h. `noise`: sensors, drifts, motions, switching, most_gain, limit, then the
 * tables of `hystmpc_noise` in their order. */
HYSTMPC_API real hystmpc_bank_init(const void *noise, real *bank, real disturbance);
HYSTMPC_API real hystmpc_bank_correct(const void *noise, real *bank, real offset, real *mean);
HYSTMPC_API real hystmpc_bank_advance(const void *noise, real *bank, real travel, real mean);

/* Filters that learn, see learning.h; `filters` is a `hystmpc_filters`, `part` a `hystmpc_learned`. */
HYSTMPC_API void hystmpc_filters_init(const hystmpc_learner *n, real *past, real *filters, real angle, real u,
                                      real y);
HYSTMPC_API void hystmpc_filters_advance(const hystmpc_learner *n, real *past, real u);
HYSTMPC_API void hystmpc_filters_correct(const hystmpc_learner *n, const real *past, real *filters, real y,
                                         real angle, real disturbance);
/* `part`, and behind it the model's angles (delay + 1) <- what is added to each. */
HYSTMPC_API void hystmpc_filters_state(const hystmpc_learner *n, const real *past, const real *filters,
                                       real *part);

/* Bytes of `hystmpc_basis`, `hystmpc_learner`, `hystmpc_filters` and `hystmpc_learned`: Python lays out the same. */
HYSTMPC_API void hystmpc_learning_bytes(int *bytes);

#endif
