/* Planning cost, admissible plans, candidates, and the condensed quadratic program around a plan. */
#ifndef HYSTMPC_LAW_H
#define HYSTMPC_LAW_H

#include "qp.h"

/* Limits, weights and blocks of moves of a predictive law over H samples: of one command and one angle, an axis. Without
 * blocks there are m = H of them, each of one sample, and the table M is not read.
 *
 * Several axes are a list. An axis without moves has an angle alone, one without tracking weights a command alone; such
 * axes stand last. In the program of nu commands and ny angles vectors stand one axis after the other: commands (nu, H),
 * angles (ny, H), J (ny, H, nu, H), unknowns (sum of all m). Every axis has the same H, and all are blocked or none. */
typedef struct hystmpc_law {
    int horizon;           /* H */
    int moves;             /* unknowns m of the axis: one a block, or one a sample; 0: no command */
    int blocked;           /* whether moves are blocked */
    int soft;              /* whether there are soft limits of the angle */
    real lower, upper;     /* of the command */
    real reach;            /* its greatest change in a sample */
    real effort_weight, soft_weight;
    const real *tracking;  /* q (H); null: no angle */
    const int *starts;     /* first and last sample of each block (m) */
    const int *ends;
    const real *blocking;  /* M (H, m) */
    const struct hystmpc_law *next; /* of the next axis; null: the last one */
} hystmpc_law;

/* What is planned for; every angle is the model's, without the disturbance of the output. */
typedef struct hystmpc_task {
    const real *reference;   /* wanted angles r (H) [deg] */
    const real *feedforward; /* the inverse plan f (H), from which effort is measured */
    real u_last;             /* the command really sent last */
    real rate_weight;        /* w_r, on the moves of the command */
    real low, high;          /* soft limits a, b of the angle [deg] */
    const struct hystmpc_task *next; /* of the next axis */
    const real *asked;       /* moves a (H) that cost nothing, since the reference asks for them; null: none */
} hystmpc_task;

/* A plan (H) sample by sample to the nearest admissible command, in place; not-a-number stays. */
HYSTMPC_LOCAL void hystmpc_clip_plan(int samples, real lower, real upper, real reach, real last, real *commands);

/* J = sum_k q_k (theta_k - r_k)^2 + w_s dist(theta_k, [a, b])^2 + w_r (u_k - u_{k-1} - a_k)^2 + w_e (u_k - f_k)^2, infinite
 * where it is not finite; summed over all axes. */
HYSTMPC_LOCAL real hystmpc_plan_cost(const hystmpc_law *l, const hystmpc_task *t, const real *commands,
                                     const real *angles);

/* Rows of candidates: hold; inverse; inverse ahead of time; half ahead; the last plan; from here on search. */
enum { HYSTMPC_HELD = 0, HYSTMPC_INVERTED = 1, HYSTMPC_FOLLOWING = 5 };

/* Admissible plans (N, H) into `plans`, and N; `boxed` (H) is the inverse within the box, row 1 of the plans holds that
 * within the rate limit already. remaining (left): what is left of the last plan; resting: with small steps. */
HYSTMPC_LOCAL int hystmpc_candidates(const hystmpc_law *l, const real *boxed, const real *remaining, int left,
                                     real u_last, int resting, real *plans);

/* Numbers nu H of a plan and ny H of its angles; unknowns of the program, its rows, and how many of them are soft. */
HYSTMPC_LOCAL int hystmpc_program_commands(const hystmpc_law *l);
HYSTMPC_LOCAL int hystmpc_program_angles(const hystmpc_law *l);
HYSTMPC_LOCAL int hystmpc_program_unknowns(const hystmpc_law *l);
HYSTMPC_LOCAL int hystmpc_program_rows(const hystmpc_law *l);
HYSTMPC_LOCAL int hystmpc_program_slacks(const hystmpc_law *l);

/* J M (ny H, m) of J (ny H, nu H), of which the angles before a command are not read; m: all unknowns. */
HYSTMPC_LOCAL void hystmpc_block_columns(const hystmpc_law *l, const real *jacobian, real *columns);

/* The program in the deviations w (m) of the moves from a plan, of which q has the room: theta ~ theta_p + J M w, with
 * `columns` = J M (ny H, m), zero where the command is later than the angle. */
HYSTMPC_LOCAL void hystmpc_build_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                         const real *commands, const real *angles, const real *columns);

/* What a planning step answers besides what qp.h says: no finite Jacobian, no finite program. */
enum { HYSTMPC_NO_JACOBIAN = -5, HYSTMPC_NO_PROGRAM = -6 };

/* The solution of that program; its rows are built where they bind. Answers as `hystmpc_solve_rows`; deviation (nu, H):
 * room. */
HYSTMPC_LOCAL int hystmpc_solve_program(hystmpc_qp *q, const hystmpc_law *l, const hystmpc_task *t,
                                        const real *commands, const real *angles, const real *columns, int changes,
                                        real *deviation);

/* Deviation M w (nu, H) of the commands from the plan. */
HYSTMPC_LOCAL void hystmpc_deviation(const hystmpc_law *l, const real *primal, real *deviation);

/* The admissible plan (nu, H) after the deviation of a solution z = w, and what it costs by the linearisation
 * theta_p + J (u - p); foreseen (ny, H): room. */
HYSTMPC_LOCAL void hystmpc_after_moves(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                       const real *commands, const real *angles, const real *primal, real *foreseen,
                                       real *plan, real *cost);

/* One step from a plan (nu, H) with this Jacobian (ny H, nu H): the program around it, its solution, the plan
 * after it and its foreseen cost. Answers as `hystmpc_solve_program`. room: ny H m numbers behind those of the program, and the
 * whole ones. */
HYSTMPC_LOCAL int hystmpc_step_plan(const hystmpc_law *l, const hystmpc_task *t, const real *jacobian,
                                    const real *commands, const real *angles, int changes, real *room, int *whole,
                                    real *plan, real *cost);

/* Shares 1/2, 1/4 and 1/8 of the way to another plan (3, H), made admissible: a line search. */
enum { HYSTMPC_SHARES = 3 };
HYSTMPC_LOCAL void hystmpc_part_plans(const hystmpc_law *l, const real *commands, const real *plan, real u_last,
                                      real *parts);

#endif
