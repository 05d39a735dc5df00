/* Vectors, and systems of equations with a positive definite matrix, on arrays of the caller. */
#ifndef HYSTMPC_LINEAR_H
#define HYSTMPC_LINEAR_H

#include "hystmpc_core.h"
#include "real.h"

#define INFINITE ((real)INFINITY)

static inline void copy(const real *from, real *to, int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

static inline void fill(real *to, real value, int count) {
    for (int i = 0; i < count; i++) to[i] = value;
}

static inline int all_finite(const real *x, int count) {
    int found = 1;
    for (int i = 0; i < count; i++) found &= is_finite(x[i]);
    return found;
}

/* The next `count` numbers of a work space. */
static inline real *take(real **room, int count) {
    real *const taken = *room;
    *room += count;
    return taken;
}

/* to += f_0 x_0 + f_1 x_1 + ..., term by term: numbers x_k of so many begin at x + k step, f_k stands at f + k apart. Four
 * terms at a time, which changes no sum: a short row costs little more than its sums. */
static inline void add_rows(real *restrict to, int count, const real *f, int apart, const real *x, int step, int terms) {
    int k = 0;
    for (; k + 4 <= terms; k += 4, f += 4 * apart, x += 4 * step) {
        const real a = f[0], b = f[apart], c = f[2 * apart], d = f[3 * apart];
        for (int i = 0; i < count; i++)
            to[i] = (((to[i] + a * x[i]) + b * x[step + i]) + c * x[2 * step + i]) + d * x[3 * step + i];
    }
    for (; k < terms; k++, f += apart, x += step)
        for (int i = 0; i < count; i++) to[i] += *f * x[i];
}

/* P = G'G in place, G lower triangular and its diagonal stored as its inverse; 0 where P is not positive definite. Of P,
 * whose rows are `width` numbers apart, the lower triangle is read. All inner loops run along rows. */
static inline int factorise(real *p, int width, int count) {
    for (int j = count - 1; j >= 0; j--) {
        real *row = p + j * width;
        for (int i = count - 1; i > j; i--) p[j * width + i] = -p[i * width + j];
        if (j + 1 < count) add_rows(row, j + 1, row + count - 1, -1, p + (count - 1) * width, -width, count - 1 - j);
        if (!(row[j] > R(0.0))) return 0;
        row[j] = R(1.0) / MATH(sqrt)(row[j]);
        for (int k = 0; k < j; k++) row[k] *= row[j];
    }
    return 1;
}

/* x <- G'^-1 x. */
static inline void solve_upper(const real *g, int width, int count, real *x) {
    for (int j = count - 1; j >= 0; j--) {
        x[j] *= g[j * width + j];
        for (int k = 0; k < j; k++) x[k] -= g[j * width + k] * x[j];
    }
}

/* x <- G^-1 x. */
static inline void solve_lower(const real *g, int width, int count, real *x) {
    for (int k = 0; k < count; k++) {
        x[k] *= g[k * width + k];
        for (int i = k + 1; i < count; i++) x[i] -= g[i * width + k] * x[k];
    }
}

#endif
