/* What Python calls of basis and learning: one call a sample where the controller in C has several. Angles in deg; the
 * state before a call is copied by the caller where it is kept. */
#ifndef HYSTMPC_CALLS_H
#define HYSTMPC_CALLS_H

#include "hystmpc_core.h"
#include "learning.h"

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
