/* min 1/2 z'Pz + q'z + sum_r s_r^2 / (2 c_r)  s.t.  lower <= A z + s <= upper,  P positive definite.
 *
 * A row r with c_r > 0 is soft and has a variable s_r; the other rows have none. */
#ifndef HYSTMPC_QP_H
#define HYSTMPC_QP_H

#include "linear.h"

/* What `hystmpc_solve_rows` answers where there is no solution; else the number of changes of the active set. */
enum {
    HYSTMPC_QP_INFEASIBLE = -1,
    HYSTMPC_QP_NOT_CONVEX = -2,
    HYSTMPC_QP_NOT_FINITE = -3,
    HYSTMPC_QP_UNFINISHED = -4 /* as many changes as are allowed */
};

/* A program and the room in which it is solved, which overwrites it. */
typedef struct {
    int unknowns, rows; /* n, m */
    int most;           /* rows that can be active at once: n, and the soft ones */
    real *hessian;      /* P (n, n), its lower triangle */
    real *gradient;     /* q (n) */
    real *columns;      /* A, a column of m numbers after the other */
    real *lower, *upper; /* (m) */
    real *soft;         /* c (m), 0 for hard rows */
    real *primal;       /* z (n), the solution */
    real *factor;       /* of the active rows (most, most) */
    real *active;       /* (most, n), turned so that each says: row x <= bound */
    real *bound, *multiplier, *along, *answer, *half; /* (most) */
    real *shift, *point, *row;                        /* (n) */
    real *at, *over;                                  /* (m) */
    int *first;         /* row of each column that is not zero (n) */
    int *index;         /* of the active rows (most) */
    int count;          /* active rows */
} hystmpc_qp;

/* Room for a program of n unknowns and m rows, `slacks` of them soft: this many numbers, and 2 n + slacks whole ones. */
HYSTMPC_LOCAL int hystmpc_qp_reals(int unknowns, int rows, int slacks);

/* A program in that room, P zero and no row written. */
HYSTMPC_LOCAL void hystmpc_place_qp(hystmpc_qp *q, int unknowns, int rows, int slacks, real *room, int *whole);

/* z without any row into `primal`, which needs P and q alone: 0, or HYSTMPC_QP_NOT_CONVEX. */
HYSTMPC_LOCAL int hystmpc_solve_free(hystmpc_qp *q);

/* After that: changes of the active set until z is in `primal`, or why there is none. */
HYSTMPC_LOCAL int hystmpc_solve_rows(hystmpc_qp *q, int changes);

#endif
