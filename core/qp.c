/* Exact solution of a convex quadratic program by a dual active-set method.
 *
 * In the metric of P and c the program is the point nearest to the origin within half-spaces: with P = G'G,
 * x = G z + G'^-1 q and rows G'^-1 a of unit length. From the origin on, the row that is violated most is made active, and
 * rows whose multiplier would change its sign are dropped on the way (Goldfarb and Idnani, Mathematical Programming 27,
 * 1983). Every step raises the dual cost, so that it ends after finitely many.
 *
 * Rows stand in the order of the samples that they bound, so that column k of A begins with zeros. G is lower triangular,
 * and so the columns of A G^-1 begin with the same zeros. They are stored as columns: an operation on all rows is one on
 * vectors. */
#include "qp.h"

#if HYSTMPC_SINGLE
static const real dependent_row = R(1e-6), violated_row = R(1e-5);
#else
static const real dependent_row = R(1e-12), violated_row = R(1e-6); /* of the squared length and of the length of a row */
#endif

HYSTMPC_LOCAL int hystmpc_qp_reals(int unknowns, int rows, int slacks) {
    const int active = unknowns + slacks;
    return unknowns * (unknowns + rows + 5) + 5 * rows + active * (active + unknowns + 5);
}

HYSTMPC_LOCAL void hystmpc_place_qp(hystmpc_qp *q, int unknowns, int rows, int slacks, real *room, int *whole) {
    const int n = unknowns, active = unknowns + slacks;
    real **const of_row[] = {&q->soft, &q->lower, &q->upper, &q->at, &q->over};
    real **const of_unknown[] = {&q->gradient, &q->primal, &q->shift, &q->point, &q->row};
    real **const of_active[] = {&q->bound, &q->multiplier, &q->along, &q->answer, &q->half};
    q->unknowns = n;
    q->rows = rows;
    q->most = active;
    q->hessian = take(&room, n * n);
    q->columns = take(&room, n * rows);
    for (int i = 0; i < 5; i++) *of_row[i] = take(&room, rows);
    for (int i = 0; i < 5; i++) *of_unknown[i] = take(&room, n);
    for (int i = 0; i < 5; i++) *of_active[i] = take(&room, active);
    q->factor = take(&room, active * active);
    q->active = take(&room, active * n);
    q->first = whole;
    q->index = whole + n;
    q->count = 0;
    fill(q->hessian, R(0.0), n * n);
}

static real inner(const real *a, const real *b, int count) {
    real sum = R(0.0);
    for (int i = 0; i < count; i++) sum += a[i] * b[i];
    return sum;
}

/* x <- (N N')^-1 x with N the active rows and N N' = LL', the inverse of L's diagonal stored; `half` keeps L^-1 x. */
static void solve_active(hystmpc_qp *q, real *x) {
    const int count = q->count, width = q->most;
    for (int i = 0; i < count; i++) {
        x[i] *= q->factor[i * width + i];
        q->half[i] = x[i];
        for (int k = i + 1; k < count; k++) x[k] -= q->factor[k * width + i] * x[i];
    }
    for (int i = count - 1; i >= 0; i--) {
        x[i] *= q->factor[i * width + i];
        for (int k = 0; k < i; k++) x[k] -= q->factor[i * width + k] * x[i];
    }
}

/* Without one of the active rows: rotations make L a triangle again. */
static void drop_row(hystmpc_qp *q, int which) {
    const int width = q->most, n = q->unknowns;
    real *const l = q->factor;
    q->count--;
    for (int i = which; i < q->count; i++) {
        q->index[i] = q->index[i + 1];
        q->bound[i] = q->bound[i + 1];
        q->multiplier[i] = q->multiplier[i + 1];
        copy(q->active + (i + 1) * n, q->active + i * n, n);
        copy(l + (i + 1) * width, l + i * width, i + 2);
    }
    for (int j = which; j < q->count; j++) {
        const real a = l[j * width + j], b = R(1.0) / l[j * width + j + 1];
        const real by_length = R(1.0) / MATH(sqrt)(a * a + b * b), c = a * by_length, s = b * by_length;
        l[j * width + j] = by_length;
        for (int i = j + 1; i < q->count; i++) {
            const real left = l[i * width + j], right = l[i * width + j + 1];
            l[i * width + j] = c * left + s * right;
            l[i * width + j + 1] = c * right - s * left;
        }
    }
}

/* The point of least distance on the active rows, from their multipliers. */
static void point_of_rows(hystmpc_qp *q) {
    const int n = q->unknowns;
    fill(q->point, R(0.0), n);
    for (int i = 0; i < q->count; i++)
        for (int k = 0; k < n; k++) q->point[k] -= q->multiplier[i] * q->active[i * n + k];
}

static void append_row(hystmpc_qp *q, int p, real bound, real multiplier, real length) {
    const int last = q->count++;
    q->index[last] = p;
    q->bound[last] = bound;
    q->multiplier[last] = multiplier;
    copy(q->row, q->active + last * q->unknowns, q->unknowns);
    copy(q->half, q->factor + last * q->most, last);
    q->factor[last * q->most + last] = R(1.0) / MATH(sqrt)(length);
}

/* Make row p active, at the bound of `side`; 0 where no point fulfils it beside the others. */
static int activate_row(hystmpc_qp *q, int p, real side) {
    const int n = q->unknowns;
    const real bound = side > R(0.0) ? q->upper[p] : -q->lower[p];
    real own = R(0.0);
    for (int k = 0; k < n; k++) q->row[k] = side * q->columns[k * q->rows + p];
    for (int i = 0; i < q->count; i++) q->along[i] = inner(q->active + i * n, q->row, n);
    for (int round = 0; round <= q->most + 1; round++) {
        real length = R(1.0), step = INFINITE;
        int blocking = -1;
        copy(q->along, q->answer, q->count);
        solve_active(q, q->answer);
        for (int i = 0; i < q->count; i++) length -= q->half[i] * q->half[i];
        const int free = q->count < q->most && length > dependent_row;
        if (free) step = (inner(q->row, q->point, n) - own * q->soft[p] - bound) / length;
        for (int i = 0; i < q->count; i++) {
            if (q->answer[i] > R(0.0) && q->multiplier[i] < step * q->answer[i]) {
                step = q->multiplier[i] / q->answer[i];
                blocking = i;
            }
        }
        if (!is_finite(step)) return 0;
        own += step;
        for (int i = 0; i < q->count; i++) q->multiplier[i] -= step * q->answer[i];
        if (blocking < 0) {
            append_row(q, p, bound, own, length);
            point_of_rows(q);
            return 1;
        }
        drop_row(q, blocking);
        for (int i = blocking; i < q->count; i++) q->along[i] = q->along[i + 1];
        point_of_rows(q);
        for (int k = 0; k < n; k++) q->point[k] -= own * q->row[k];
    }
    return 0;
}

/* Rows of the program in its metric, of unit length; those without length bound nothing. `soft` becomes the share of s in
 * a row's squared length. */
static void scale_rows(hystmpc_qp *q) {
    const int n = q->unknowns, rows = q->rows;
    real *const length = q->at, *const offset = q->over;
    copy(q->soft, length, rows);
    fill(offset, R(0.0), rows);
    for (int j = n - 1; j >= 0; j--) {
        real *const column = q->columns + j * rows;
        const real *const g = q->hessian + j * n;
        const int first = q->first[j];
        for (int r = first; r < rows; r++) {
            column[r] *= g[j];
            length[r] += column[r] * column[r];
            offset[r] += column[r] * q->shift[j];
        }
        for (int k = 0; k < j; k++)
            for (int r = first; r < rows; r++) q->columns[k * rows + r] -= g[k] * column[r];
    }
    for (int r = 0; r < rows; r++) {
        const int bounds = length[r] > R(0.0);
        const real by_length = bounds ? R(1.0) / MATH(sqrt)(length[r]) : R(0.0);
        q->soft[r] *= by_length * by_length;
        q->lower[r] = bounds ? (q->lower[r] + offset[r]) * by_length : -INFINITE;
        q->upper[r] = bounds ? (q->upper[r] + offset[r]) * by_length : INFINITE;
        length[r] = by_length;
    }
    for (int j = 0; j < n; j++)
        for (int r = q->first[j]; r < rows; r++) q->columns[j * rows + r] *= length[r];
}

/* The row that is violated most, and its side: 1 at the upper bound, -1 at the lower one; -1 where no row is. */
static int most_violated(hystmpc_qp *q, real *side) {
    const int rows = q->rows;
    real violation = violated_row;
    int worst = -1;
    fill(q->at, R(0.0), rows);
    for (int j = 0; j < q->unknowns; j++)
        for (int r = q->first[j]; r < rows; r++) q->at[r] += q->columns[j * rows + r] * q->point[j];
    for (int r = 0; r < rows; r++) q->over[r] = most(q->at[r] - q->upper[r], q->lower[r] - q->at[r]);
    for (int i = 0; i < q->count; i++) q->over[q->index[i]] = R(0.0); /* what an active row is off is rounding */
    for (int r = 0; r < rows; r++) {
        if (q->over[r] > violation) {
            violation = q->over[r];
            worst = r;
        }
    }
    *side = worst >= 0 && q->at[worst] > q->upper[worst] ? R(1.0) : R(-1.0);
    return worst;
}

/* Whether the point without any row fulfils all rows: then nothing else has to be computed. */
static int rows_fit(hystmpc_qp *q) {
    const int n = q->unknowns, rows = q->rows;
    int fits = 1;
    fill(q->at, R(0.0), rows);
    add_rows(q->at, rows, q->primal, 1, q->columns, rows, n);
    for (int r = 0; r < rows; r++) fits &= q->lower[r] <= q->at[r] && q->at[r] <= q->upper[r];
    return fits && all_finite(q->primal, n);
}

HYSTMPC_LOCAL int hystmpc_solve_free(hystmpc_qp *q) {
    const int n = q->unknowns;
    if (!factorise(q->hessian, n, n)) return HYSTMPC_QP_NOT_CONVEX;
    copy(q->gradient, q->shift, n);
    solve_upper(q->hessian, n, n, q->shift);
    for (int k = 0; k < n; k++) q->primal[k] = R(0.0) - q->shift[k];
    solve_lower(q->hessian, n, n, q->primal);
    return 0;
}

HYSTMPC_LOCAL int hystmpc_solve_rows(hystmpc_qp *q, int changes) {
    const int n = q->unknowns, rows = q->rows;
    int change = 0;
    real side;
    if (rows_fit(q)) return 0;
    for (int j = n - 1, before = rows; j >= 0; j--) {
        int r = 0;
        while (r < before && q->columns[j * rows + r] == R(0.0)) r++;
        q->first[j] = before = r;
    }
    scale_rows(q);
    fill(q->point, R(0.0), n);
    for (int worst; (worst = most_violated(q, &side)) >= 0; change++) {
        if (change == changes) return HYSTMPC_QP_UNFINISHED;
        if (!activate_row(q, worst, side)) return HYSTMPC_QP_INFEASIBLE;
    }
    for (int i = 0; i < q->count; i++) q->multiplier[i] = -q->bound[i];
    solve_active(q, q->multiplier); /* once more, without what has been rounded on the way */
    point_of_rows(q);
    for (int k = 0; k < n; k++) q->primal[k] = q->point[k] - q->shift[k];
    solve_lower(q->hessian, n, n, q->primal);
    return all_finite(q->primal, n) ? change : HYSTMPC_QP_NOT_FINITE;
}
