/* min 1/2 z'Pz + q'z + w |s|^2  s.t.  lower <= A z + s <= upper, P positive definite: a dual active-set method.
 *
 * There is an s for each row of soft limits, and none for the others. In the metric of P and w the program is the point
 * nearest to the origin within half-spaces: with P = G'G, x = G z + G'^-1 q and rows G'^-1 a of unit length. From the
 * origin on, the row that is violated most is made active, and rows whose multiplier would change its sign are dropped on
 * the way (Goldfarb and Idnani, Mathematical Programming 27, 1983). Every step raises the dual cost, so that it ends
 * after finitely many.
 *
 * Rows stand in the order of the samples that they bound, so that column k of A begins with zeros. G is lower
 * triangular, and so the columns of A G^-1 begin with the same zeros. They are stored as columns: an operation on all
 * rows is one on vectors. */
#include "internal.h"

enum { N = HYSTMPC_QP_MOVES, ROWS = HYSTMPC_QP_ROWS, MOST_ACTIVE = HYSTMPC_QP_SIZE };

static real dot(const real *a, const real *b) {
    real sum = R(0.0);
    for (int i = 0; i < N; i++) sum += a[i] * b[i];
    return sum;
}

/* Active rows, turned so that each says: row x <= bound. */
typedef struct {
    int count;
    int index[HYSTMPC_QP_SIZE];
    real bound[HYSTMPC_QP_SIZE];
    real multiplier[HYSTMPC_QP_SIZE]; /* not negative */
} active;

/* x <- (N N')^-1 x with N the active rows and N N' = LL', the inverse of L's diagonal stored; `half` keeps L^-1 x. */
static void solve_active(const hystmpc_work *w, const active *set, real *x, real *half) {
    for (int i = 0; i < set->count; i++) {
        x[i] *= w->factor[i][i];
        half[i] = x[i];
        for (int k = i + 1; k < set->count; k++) x[k] -= w->factor[k][i] * x[i];
    }
    for (int i = set->count - 1; i >= 0; i--) {
        x[i] *= w->factor[i][i];
        for (int k = 0; k < i; k++) x[k] -= w->factor[i][k] * x[i];
    }
}

/* Without one of the active rows: rotations make L a triangle again. */
static void drop(hystmpc_work *w, active *set, int which) {
    real(*l)[HYSTMPC_QP_SIZE] = w->factor;
    set->count--;
    for (int i = which; i < set->count; i++) {
        set->index[i] = set->index[i + 1];
        set->bound[i] = set->bound[i + 1];
        set->multiplier[i] = set->multiplier[i + 1];
        copy(w->active[i + 1], w->active[i], N);
        copy(l[i + 1], l[i], i + 2);
    }
    for (int j = which; j < set->count; j++) {
        const real a = l[j][j], b = R(1.0) / l[j][j + 1], by_length = R(1.0) / root(a * a + b * b);
        const real c = a * by_length, s = b * by_length;
        l[j][j] = by_length;
        for (int i = j + 1; i < set->count; i++) {
            const real left = l[i][j], right = l[i][j + 1];
            l[i][j] = c * left + s * right;
            l[i][j + 1] = c * right - s * left;
        }
    }
}

/* The point of least distance on the active rows, from their multipliers. */
static void point_of(const hystmpc_work *w, const active *set, real *point) {
    fill(point, R(0.0), N);
    for (int i = 0; i < set->count; i++)
        for (int k = 0; k < N; k++) point[k] -= set->multiplier[i] * w->active[i][k];
}

/* Make row p active, at the bound of `side`; 0 where no point fulfils it beside the others. */
static int activate(hystmpc_work *w, active *set, real *point, int p, real side) {
    const real bound = side > R(0.0) ? w->upper[p] : -w->lower[p];
    real own = R(0.0), row[HYSTMPC_QP_MOVES], along[HYSTMPC_QP_SIZE], answer[HYSTMPC_QP_SIZE], half[HYSTMPC_QP_SIZE];
    for (int k = 0; k < N; k++) row[k] = side * w->columns[k][p];
    for (int i = 0; i < set->count; i++) along[i] = dot(w->active[i], row);
    for (int round = 0; round <= MOST_ACTIVE + 1; round++) {
        real length = R(1.0), step = INFINITE;
        int blocking = -1;
        copy(along, answer, set->count);
        solve_active(w, set, answer, half);
        for (int i = 0; i < set->count; i++) length -= half[i] * half[i];
        const int free = set->count < MOST_ACTIVE && length > HYSTMPC_DEPENDENT;
        if (free) step = (dot(row, point) - own * w->soft[p] - bound) / length;
        for (int i = 0; i < set->count; i++) {
            if (answer[i] > R(0.0) && set->multiplier[i] < step * answer[i]) {
                step = set->multiplier[i] / answer[i];
                blocking = i;
            }
        }
        if (!is_finite(step)) return 0;
        own += step;
        for (int i = 0; i < set->count; i++) set->multiplier[i] -= step * answer[i];
        if (blocking < 0) {
            const int last = set->count++;
            set->index[last] = p;
            set->bound[last] = bound;
            set->multiplier[last] = own;
            copy(row, w->active[last], N);
            copy(half, w->factor[last], last);
            w->factor[last][last] = R(1.0) / root(length);
            point_of(w, set, point);
            return 1;
        }
        drop(w, set, blocking);
        for (int i = blocking; i < set->count; i++) along[i] = along[i + 1];
        point_of(w, set, point);
        for (int k = 0; k < N; k++) point[k] -= own * row[k];
    }
    return 0;
}

/* Rows of the program in its metric, of unit length; those without length bound nothing. `soft` becomes the share of s in
 * a row's squared length. */
static void scale_rows(hystmpc_work *w, const real *shift) {
    real length[HYSTMPC_QP_ROWS], offset[HYSTMPC_QP_ROWS];
    copy(w->soft, length, ROWS);
    fill(offset, R(0.0), ROWS);
    for (int j = N - 1; j >= 0; j--) {
        real *column = w->columns[j];
        const int first = w->first[j];
        for (int r = first; r < ROWS; r++) {
            column[r] *= w->hessian[j][j];
            length[r] += column[r] * column[r];
            offset[r] += column[r] * shift[j];
        }
        for (int k = 0; k < j; k++)
            for (int r = first; r < ROWS; r++) w->columns[k][r] -= w->hessian[j][k] * column[r];
    }
    for (int r = 0; r < ROWS; r++) {
        const int bounds = length[r] > R(0.0);
        const real by_length = bounds ? R(1.0) / root(length[r]) : R(0.0);
        w->soft[r] *= by_length * by_length;
        w->lower[r] = bounds ? (w->lower[r] + offset[r]) * by_length : -INFINITE;
        w->upper[r] = bounds ? (w->upper[r] + offset[r]) * by_length : INFINITE;
        length[r] = by_length;
    }
    for (int j = 0; j < N; j++)
        for (int r = w->first[j]; r < ROWS; r++) w->columns[j][r] *= length[r];
}

/* The row that is violated most, and its side: 1 at the upper bound, -1 at the lower one; -1 where no row is. */
static int most_violated(const hystmpc_work *w, const active *set, const real *point, real *side) {
    real at[HYSTMPC_QP_ROWS], over[HYSTMPC_QP_ROWS], violation = HYSTMPC_VIOLATION;
    int worst = -1;
    fill(at, R(0.0), ROWS);
    for (int j = 0; j < N; j++)
        for (int r = w->first[j]; r < ROWS; r++) at[r] += w->columns[j][r] * point[j];
    for (int r = 0; r < ROWS; r++) over[r] = most(at[r] - w->upper[r], w->lower[r] - at[r]);
    for (int i = 0; i < set->count; i++) over[set->index[i]] = R(0.0); /* what an active row is off is rounding */
    for (int r = 0; r < ROWS; r++) {
        if (over[r] > violation) {
            violation = over[r];
            worst = r;
        }
    }
    *side = worst >= 0 && at[worst] > w->upper[worst] ? R(1.0) : R(-1.0);
    return worst;
}

/* The program in the work space; 0 where it has no solution. Its data are overwritten. */
HYSTMPC_LOCAL int solve_program(hystmpc_work *w, real *primal) {
    active set;
    real shift[HYSTMPC_QP_MOVES], point[HYSTMPC_QP_MOVES], half[HYSTMPC_QP_SIZE], side;
    if (!factorise(w->hessian[0], N, N)) return 0;
    copy(w->gradient, shift, N);
    solve_upper(w->hessian[0], N, N, shift);
    for (int j = 0, r = 0; j < N; j++) {
        while (r < ROWS && w->columns[j][r] == R(0.0)) r++;
        w->first[j] = r;
    }
    scale_rows(w, shift);
    set.count = 0;
    fill(point, R(0.0), N);
    for (int change = 0;; change++) {
        const int worst = most_violated(w, &set, point, &side);
        if (worst < 0) break;
        if (change == HYSTMPC_CHANGES || !activate(w, &set, point, worst, side)) return 0;
    }
    for (int i = 0; i < set.count; i++) set.multiplier[i] = -set.bound[i];
    solve_active(w, &set, set.multiplier, half); /* once more, without what has been rounded on the way */
    point_of(w, &set, point);
    for (int k = 0; k < N; k++) primal[k] = point[k] - shift[k];
    solve_lower(w->hessian[0], N, N, primal);
    return all_finite(primal, N);
}
