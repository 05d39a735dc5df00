/* The predictive law as Python calls it: structs in arrays of Python, many plans at once, one call a planning step.
 *
 * A `law` is a `hystmpc_law` that `hystmpc_law_init` has made. A `task` is a row of numbers: the last command, soft limits
 * a and b [deg], wanted angles r (H) [deg], inverse plan f (H). `room` has `hystmpc_law_bytes`. Of these three addresses are
 * given, which takes less time. Plans are (N, H), angles too [deg]; a plan with its angles is where a step begins. */
#ifndef HYSTMPC_PLANNING_H
#define HYSTMPC_PLANNING_H

#include "hystmpc_core.h"
#include "law.h"

HYSTMPC_LOCAL hystmpc_task hystmpc_task_of(const hystmpc_law *l, const void *task);

/* A program of this law in `room`; answers what is behind it, of H m + (m + 1) (m + H) numbers. */
HYSTMPC_LOCAL real *hystmpc_place_program(const hystmpc_law *l, void *room, hystmpc_qp *q);

/* Bytes of `hystmpc_law`, of the room for a law's program and for `more` numbers, of that for any program. */
HYSTMPC_API int hystmpc_law_size(void);
HYSTMPC_API int hystmpc_law_bytes(const void *law, int more);
HYSTMPC_API int hystmpc_qp_bytes(int unknowns, int rows, int slacks);

/* Room of `hystmpc_step_plan` (2): numbers and whole numbers. */
HYSTMPC_API void hystmpc_step_room(const void *law, int *sizes);

/* A law of two tables, which stay where they are. whole: H, m, whether moves are blocked, whether angles have soft limits,
 * first samples of the blocks (m), last ones (m). numbers: least and greatest command, greatest change; weights of moves,
 * effort and soft limits; q (H); with blocks M (H, m) and the constant part of the Hessian (m, m). */
HYSTMPC_API void hystmpc_law_init(const int *whole, const real *numbers, char *law);

/* Plans sample by sample to the nearest admissible commands after `last`, in place; not-a-number stays. */
HYSTMPC_API void hystmpc_clip_plans(int count, int samples, real lower, real upper, real reach, real last,
                                    real *plans);

/* The costs (N) of plans; the first plan that costs least, and its cost alone. */
HYSTMPC_API void hystmpc_costs(const void *law, const void *task, int count, const real *plans,
                               const real *angles, real *costs);
HYSTMPC_API int hystmpc_cheapest(const void *law, const void *task, int count, const real *plans,
                                 const real *angles, real *cost);

/* Candidates, and N; targets (2, H): the inverse within the box, and within the rate limit; remaining (left): of the last
 * plan; resting: with small steps. */
HYSTMPC_API int hystmpc_fill_candidates(const void *law, const real *targets, const real *remaining, int left,
                                        real u_last, int resting, real *plans);

/* J M (H, m). */
HYSTMPC_API void hystmpc_blocked_jacobian(const void *law, const real *jacobian, real *columns);

/* The program around a plan, where J M = `columns` (H, m): P (m, m) of which the lower triangle is filled, q (m), A (m, R)
 * by columns, and (3, R) lower and upper bounds and soft shares; R = H + m, and H more with soft limits. */
HYSTMPC_API void hystmpc_program(const void *law, const void *task, const real *columns, const real *commands,
                                 const real *angles, void *room, real *hessian, real *gradient, real *rows,
                                 real *bounds);

/* z (n) of a program as above; answers the number of changes of the active set, or what qp.h says. */
HYSTMPC_API int hystmpc_quadratic_program(int unknowns, int rows, const real *hessian, const real *gradient,
                                          const real *columns, const real *lower, const real *upper,
                                          const real *soft, int changes, char *room, real *primal);

/* One step from a plan with this Jacobian (H, H): the program around it, its solution, and in `out` the admissible plan
 * after it (H) and what that costs by the linearisation. Answers as `hystmpc_quadratic_program`. */
HYSTMPC_API int hystmpc_plan_step(const void *law, const void *task, const real *jacobian, const real *commands,
                                  const real *angles, int changes, void *room, real *out);

/* The same of a solution z (m) that is known. */
HYSTMPC_API void hystmpc_plan_after(const void *law, const void *task, const real *jacobian,
                                    const real *commands, const real *angles, const real *primal, void *room,
                                    real *out);

/* Parts of the way to another plan (3, H), admissible. */
HYSTMPC_API void hystmpc_parts_of_step(const void *law, const real *commands, const real *plan, real u_last,
                                       real *parts);

#endif
