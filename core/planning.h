/* The predictive law as Python calls it: two tables in place of a struct, many plans at once.
 *
 * whole: H, m, whether moves are blocked, whether angles have soft limits, first samples of the blocks (m), last ones (m).
 * numbers: least and greatest command, greatest change; weights of moves, effort and soft limits; q (H); with blocks M
 * (H, m) and the constant part of the Hessian (m, m). A task is r (H), f (H), the last command, soft limits a and b. */
#ifndef HYSTMPC_PLANNING_H
#define HYSTMPC_PLANNING_H

#include "hystmpc_core.h"
#include "law.h"

hystmpc_law hystmpc_law_of(const int *whole, const double *numbers);

/* A program of this law in a work space of `hystmpc_law_bytes`; answers the room behind it, of
 * H m + (m + 1) (m + H) numbers. */
double *hystmpc_place_program(const hystmpc_law *l, char *work, hystmpc_qp *q);

/* Plans (N, H) sample by sample to the nearest admissible commands after `last`, in place; all after a not-a-number are
 * none. */
HYSTMPC_API void hystmpc_clip_plans(int count, int samples, double lower, double upper, double reach, double last,
                                    double *plans);

/* The first of the plans (N, H) with angles (N, H) that costs least, and the costs (N). */
HYSTMPC_API int hystmpc_cheapest(const int *whole, const double *numbers, int count, const double *plans,
                                 const double *angles, const double *reference, const double *feedforward,
                                 double u_last, double low, double high, double *costs);

/* Candidates (N, H), and N; targets (2, H): the inverse within the box, and within the rate limit; remaining (left): of
 * the last plan; resting: with small steps. */
HYSTMPC_API int hystmpc_fill_candidates(const int *whole, const double *numbers, const double *targets,
                                        const double *remaining, int left, double u_last, int resting, double *plans);

HYSTMPC_API int hystmpc_law_bytes(const int *whole);
HYSTMPC_API int hystmpc_qp_bytes(int unknowns, int rows, int slacks);

/* The program around the plan `commands` (H) with `angles` (H), where J M = `columns` (H, m): P (m, m) of which the lower
 * triangle is filled, q (m), A by columns (m, R), bounds and soft shares (R), R = `hystmpc_program_rows`. */
HYSTMPC_API void hystmpc_program(const int *whole, const double *numbers, const double *columns,
                                 const double *reference, const double *feedforward, double u_last, double low,
                                 double high, const double *commands, const double *angles, char *work,
                                 double *hessian, double *gradient, double *rows, double *bounds);

/* z (n) of a program as above; answers the number of changes of the active set, or what qp.h says. */
HYSTMPC_API int hystmpc_quadratic_program(int unknowns, int rows, const double *hessian, const double *gradient,
                                          const double *columns, const double *lower, const double *upper,
                                          const double *soft, int changes, char *work, double *primal);

/* J M (H, m). */
HYSTMPC_API void hystmpc_blocked_jacobian(const int *whole, const double *numbers, const double *jacobian,
                                          double *columns);

/* What a planning step answers besides the program's: no finite Jacobian, no finite program. */
enum { HYSTMPC_NO_JACOBIAN = -5, HYSTMPC_NO_PROGRAM = -6 };

/* One step from a plan with this Jacobian (H, H): the program around it, its solution, and in `out` the admissible plan
 * after it (H) and what that costs by the linearisation. Answers as `hystmpc_quadratic_program`. */
HYSTMPC_API int hystmpc_plan_step(const int *whole, const double *numbers, const double *jacobian,
                                  const double *reference, const double *feedforward, double u_last, double low,
                                  double high, const double *commands, const double *angles, int changes, char *work,
                                  double *out);

/* The admissible plan after a deviation of the moves (m), and its foreseen cost, in `out` as above. */
HYSTMPC_API void hystmpc_after_moves(const int *whole, const double *numbers, const double *jacobian,
                                     const double *reference, const double *feedforward, double u_last, double low,
                                     double high, const double *commands, const double *angles, const double *primal,
                                     char *work, double *out);

/* Parts of the way to another plan (3, H), admissible. */
HYSTMPC_API void hystmpc_parts_of_step(const int *whole, const double *numbers, const double *commands,
                                       const double *plan, double u_last, double *parts);

#endif
