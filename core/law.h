/* Planning cost, admissible plans, candidates, and the condensed quadratic program around a plan. */
#ifndef HYSTMPC_LAW_H
#define HYSTMPC_LAW_H

#include "qp.h"

/* Limits, weights and blocks of moves of a predictive law over H samples. Without blocks there are m = H of them, and
 * their three tables are not read. */
typedef struct {
    int horizon;           /* H */
    int moves;             /* unknowns m of the program: one a block, or one a sample */
    int blocked;           /* whether moves are blocked */
    int soft;              /* whether there are soft limits of the angle */
    real lower, upper;     /* of the command */
    real reach;            /* its greatest change in a sample */
    real rate_weight, effort_weight, soft_weight;
    const real *tracking;  /* q (H) */
    const int *starts;     /* first and last sample of each block (m) */
    const int *ends;
    const real *blocking;  /* M (H, m) */
    const real *constant;  /* 2 (w_r (D M)'D M + w_e M'M) (m, m), D the difference matrix */
} hystmpc_law;

/* What is planned for; every angle is the model's, without the disturbance of the output. */
typedef struct {
    const real *reference;   /* wanted angles r (H) [deg] */
    const real *feedforward; /* the inverse plan f (H), from which effort is measured */
    real u_last;             /* the command really sent last */
    real low, high;          /* soft limits a, b of the angle [deg] */
} hystmpc_task;

/* A plan (H) sample by sample to the nearest admissible command, in place; not-a-number stays. */
HYSTMPC_LOCAL void hystmpc_clip_plan(int samples, real lower, real upper, real reach, real last, real *commands);

/* J = sum_k q_k (theta_k - r_k)^2 + w_s dist(theta_k, [a, b])^2 + w_r (u_k - u_{k-1})^2 + w_e (u_k - f_k)^2, infinite
 * where it is not finite. */
HYSTMPC_LOCAL real hystmpc_plan_cost(const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                                     const real *angles);

/* Rows of candidates: hold; inverse; inverse ahead of time; half ahead; the last plan; from here on search. */
enum { HYSTMPC_HELD = 0, HYSTMPC_INVERTED = 1, HYSTMPC_FOLLOWING = 5 };

/* Admissible plans (N, H) into `plans`, and N; `boxed` (H) is the inverse within the box, row 1 of the plans holds that
 * within the rate limit already. remaining (left): what is left of the last plan; resting: with small steps. */
HYSTMPC_LOCAL int hystmpc_candidates(const hystmpc_law *l, const real *boxed, const real *remaining, int left,
                                     real u_last, int resting, real *plans);

/* Rows of the program, and how many of them are soft. */
HYSTMPC_LOCAL int hystmpc_program_rows(const hystmpc_law *l);
HYSTMPC_LOCAL int hystmpc_program_slacks(const hystmpc_law *l);

/* J M (H, m) of a lower triangular J (H, H). */
HYSTMPC_LOCAL void hystmpc_block_columns(const hystmpc_law *l, const real *jacobian, real *columns);

/* The program in the deviations w (m) of the moves from a plan, of which q has the room: theta ~ theta_p + J M w, with
 * `columns` = J M (H, m). */
HYSTMPC_LOCAL void hystmpc_build_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                         const real *commands, const real *angles, const real *columns);

/* Deviation M w (H) of the commands from the plan. */
HYSTMPC_LOCAL void hystmpc_deviation(const hystmpc_law *l, const real *primal, real *deviation);

/* Angles (H) of another plan by the linearisation: theta_p + J (u - p), J (H, H) lower triangular. */
HYSTMPC_LOCAL void hystmpc_foresee(int samples, const real *commands, const real *angles, const real *jacobian,
                                   const real *plan, real *foreseen);

/* Shares 1/2, 1/4 and 1/8 of the way to another plan (3, H), made admissible: a line search. */
enum { HYSTMPC_SHARES = 3 };
HYSTMPC_LOCAL void hystmpc_part_plans(const hystmpc_law *l, const real *commands, const real *plan, real u_last,
                                      real *parts);

#endif
