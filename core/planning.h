/* The predictive law as Python calls it: admissible plans, and the quadratic program of a planning step, which OSQP can
 * solve in place of qp.c.
 *
 * A `law` is a `hystmpc_law`, a `task` a `hystmpc_task`. With nu commands and ny angles plans are (nu, H), angles (ny, H)
 * [deg] and J (ny, H, nu, H) is the Jacobian of the angles [deg per command unit], zero where the command is later. */
#ifndef HYSTMPC_PLANNING_H
#define HYSTMPC_PLANNING_H

#include "hystmpc_core.h"
#include "law.h"

/* Plans (N, H) sample by sample to the nearest admissible commands after `last`, in place; not-a-number stays. */
HYSTMPC_API void hystmpc_clip_plans(int count, int samples, real lower, real upper, real reach, real last,
                                    real *plans);

/* Bytes of the room for the program of a law, and for any program, `slacks` rows of which are soft. */
HYSTMPC_API int hystmpc_law_bytes(const void *law);
HYSTMPC_API int hystmpc_qp_bytes(int unknowns, int rows, int slacks);

/* The program around a plan: P (m, m) of which the lower triangle is filled, q (m), A (m, R) by columns, and (3, R) lower
 * and upper bounds and soft shares; R = nu H + m, and H more for each angle with soft limits. */
HYSTMPC_API void hystmpc_program(const void *law, const void *task, const real *jacobian, const real *commands,
                                 const real *angles, char *room, real *hessian, real *gradient, real *rows,
                                 real *bounds);

/* The admissible plan (nu, H) after a solution z (m) of that program, and behind it its cost by the linearisation. */
HYSTMPC_API void hystmpc_plan_after(const void *law, const void *task, const real *jacobian, const real *commands,
                                    const real *angles, const real *primal, char *room, real *out);

/* z (n) of a program as above; answers the number of changes of the active set, or what qp.h says. */
HYSTMPC_API int hystmpc_quadratic_program(int unknowns, int rows, const real *hessian, const real *gradient,
                                          const real *columns, const real *lower, const real *upper,
                                          const real *soft, int changes, char *room, real *primal);

#endif
