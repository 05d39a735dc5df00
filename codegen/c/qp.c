/* min 1/2 z'Pz + q'z  s.t.  lower <= A z <= upper, P positive definite: a dual active-set method.
 *
 * In the metric of P the program is the point nearest to the origin within half-spaces: with P = LL', w = L'z + L^-1 q
 * and rows L^-1 a of unit length. From the origin on, the row that is violated most is made active, and rows whose
 * multiplier would change its sign are dropped on the way (Goldfarb and Idnani, Mathematical Programming 27, 1983).
 * Every step raises the dual cost, so that it ends after finitely many. */
#include "internal.h"

enum { N = HYSTMPC_QP_SIZE, ROWS = HYSTMPC_QP_ROWS };

/* P = LL' in place; 0 where P is not positive definite. */
static int factorise(real (*p)[HYSTMPC_QP_SIZE]) {
    for (int j = 0; j < N; j++) {
        for (int i = j; i < N; i++) {
            real sum = p[i][j];
            for (int k = 0; k < j; k++) sum -= p[i][k] * p[j][k];
            if (i == j) {
                if (!(sum > R(0.0))) return 0;
                p[j][j] = root(sum);
            } else {
                p[i][j] = sum / p[j][j];
            }
        }
    }
    return 1;
}

/* x <- L^-1 x, from the first entry on that is not zero. */
static void forward(real (*l)[HYSTMPC_QP_SIZE], real *x) {
    int first = 0;
    while (first < N && x[first] == R(0.0)) first++;
    for (int i = first; i < N; i++) {
        real sum = x[i];
        for (int k = first; k < i; k++) sum -= l[i][k] * x[k];
        x[i] = sum / l[i][i];
    }
}

static void backward(real (*l)[HYSTMPC_QP_SIZE], real *x) {
    for (int i = N - 1; i >= 0; i--) {
        x[i] /= l[i][i];
        for (int k = 0; k < i; k++) x[k] -= l[i][k] * x[i];
    }
}

static real dot(const real *a, const real *b) {
    real sum = R(0.0);
    for (int i = 0; i < N; i++) sum += a[i] * b[i];
    return sum;
}

typedef struct {
    int count;
    int row[HYSTMPC_QP_SIZE];
    real side[HYSTMPC_QP_SIZE];       /* 1 at the upper bound, -1 at the lower one */
    real multiplier[HYSTMPC_QP_SIZE]; /* not negative */
} active;

/* Rows of the factor of the active rows' products, from `first` on. */
static void factor_rows(hystmpc_work *w, const active *set, int first) {
    for (int i = first; i < set->count; i++) {
        for (int j = 0; j <= i; j++) {
            real sum = set->side[i] * set->side[j] * dot(w->rows[set->row[i]], w->rows[set->row[j]]);
            for (int k = 0; k < j; k++) sum -= w->factor[i][k] * w->factor[j][k];
            w->factor[i][j] = i == j ? root(most(sum, R(0.0))) : sum / w->factor[j][j];
        }
    }
}

/* x <- (N'N)^-1 x with N the active rows; `half` keeps the forward half. */
static void solve_active(hystmpc_work *w, const active *set, real *x, real *half) {
    for (int i = 0; i < set->count; i++) {
        for (int k = 0; k < i; k++) x[i] -= w->factor[i][k] * x[k];
        x[i] /= w->factor[i][i];
        half[i] = x[i];
    }
    for (int i = set->count - 1; i >= 0; i--) {
        for (int k = i + 1; k < set->count; k++) x[i] -= w->factor[k][i] * x[k];
        x[i] /= w->factor[i][i];
    }
}

static void drop(hystmpc_work *w, active *set, int which) {
    set->count--;
    for (int i = which; i < set->count; i++) {
        set->row[i] = set->row[i + 1];
        set->side[i] = set->side[i + 1];
        set->multiplier[i] = set->multiplier[i + 1];
    }
    factor_rows(w, set, which);
}

/* The point of least distance on the active rows, from their multipliers. */
static void point_of(const hystmpc_work *w, const active *set, real *point) {
    fill(point, R(0.0), N);
    for (int i = 0; i < set->count; i++) {
        const real factor = set->side[i] * set->multiplier[i];
        for (int k = 0; k < N; k++) point[k] -= factor * w->rows[set->row[i]][k];
    }
}

/* Make row p active, at the bound of `side`; 0 where no point fulfils it beside the others. */
static int activate(hystmpc_work *w, active *set, real *point, int p, real side) {
    const real bound = side > R(0.0) ? w->upper[p] : -w->lower[p];
    real own = R(0.0), answer[HYSTMPC_QP_SIZE], half[HYSTMPC_QP_SIZE];
    for (int round = 0; round <= N + 1; round++) {
        real length = R(1.0), step = INFINITE;
        int blocking = -1;
        for (int i = 0; i < set->count; i++)
            answer[i] = side * set->side[i] * dot(w->rows[set->row[i]], w->rows[p]);
        solve_active(w, set, answer, half);
        for (int i = 0; i < set->count; i++) length -= half[i] * half[i];
        const int free = set->count < N && length > HYSTMPC_DEPENDENT;
        if (free) step = (side * dot(w->rows[p], point) - bound) / length;
        for (int i = 0; i < set->count; i++) {
            if (answer[i] > R(0.0) && set->multiplier[i] < step * answer[i]) {
                step = set->multiplier[i] / answer[i];
                blocking = i;
            }
        }
        if (!finite(step)) return 0;
        own += step;
        for (int i = 0; i < set->count; i++) set->multiplier[i] -= step * answer[i];
        if (blocking < 0) {
            set->row[set->count] = p;
            set->side[set->count] = side;
            set->multiplier[set->count] = own;
            set->count++;
            factor_rows(w, set, set->count - 1);
            point_of(w, set, point);
            return 1;
        }
        drop(w, set, blocking);
        point_of(w, set, point);
        for (int k = 0; k < N; k++) point[k] -= side * own * w->rows[p][k];
    }
    return 0;
}

/* Rows of the program in its metric, of unit length; those without length bound nothing. */
static void scale_rows(hystmpc_work *w, const real *shift) {
    for (int r = 0; r < ROWS; r++) {
        forward(w->hessian, w->rows[r]);
        const real length = root(dot(w->rows[r], w->rows[r])), offset = dot(w->rows[r], shift);
        if (!(length > R(0.0))) {
            w->lower[r] = -INFINITE;
            w->upper[r] = INFINITE;
            continue;
        }
        for (int k = 0; k < N; k++) w->rows[r][k] /= length;
        w->lower[r] = (w->lower[r] + offset) / length;
        w->upper[r] = (w->upper[r] + offset) / length;
    }
}

/* The program in the work space; 0 where it has no solution. Its data are overwritten. */
HYSTMPC_LOCAL int solve_program(hystmpc_work *w, real *primal) {
    active set = {0, {0}, {R(0.0)}, {R(0.0)}};
    real shift[HYSTMPC_QP_SIZE], point[HYSTMPC_QP_SIZE], exact[HYSTMPC_QP_SIZE], half[HYSTMPC_QP_SIZE];
    if (!factorise(w->hessian)) return 0;
    copy(w->gradient, shift, N);
    forward(w->hessian, shift);
    scale_rows(w, shift);
    fill(point, R(0.0), N);
    for (int change = 0;; change++) {
        int worst = -1;
        real violation = HYSTMPC_VIOLATION, side = R(1.0);
        for (int r = 0; r < ROWS; r++) {
            const real at = dot(w->rows[r], point);
            if (at - w->upper[r] > violation) {
                violation = at - w->upper[r];
                worst = r;
                side = R(1.0);
            } else if (w->lower[r] - at > violation) {
                violation = w->lower[r] - at;
                worst = r;
                side = R(-1.0);
            }
        }
        if (worst < 0) break;
        if (change == HYSTMPC_CHANGES || !activate(w, &set, point, worst, side)) return 0;
    }
    for (int i = 0; i < set.count; i++) /* the multipliers once more, without what has been rounded on the way */
        exact[i] = set.side[i] > R(0.0) ? -w->upper[set.row[i]] : w->lower[set.row[i]];
    solve_active(w, &set, exact, half);
    copy(exact, set.multiplier, set.count);
    point_of(w, &set, point);
    for (int k = 0; k < N; k++) primal[k] = point[k] - shift[k];
    backward(w->hessian, primal);
    for (int k = 0; k < N; k++)
        if (!finite(primal[k])) return 0;
    return 1;
}
