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

/* P = G'G in place, G lower triangular and its diagonal stored as its inverse; 0 where P is not positive definite. Of P,
 * whose rows are `width` numbers apart, the lower triangle is read. All inner loops run along rows. */
static inline int factorise(real *p, int width, int count) {
    for (int j = count - 1; j >= 0; j--) {
        real *row = p + j * width;
        if (!(row[j] > R(0.0))) return 0;
        row[j] = R(1.0) / MATH(sqrt)(row[j]);
        for (int k = 0; k < j; k++) row[k] *= row[j];
        for (int i = 0; i < j; i++)
            for (int k = 0; k <= i; k++) p[i * width + k] -= row[i] * row[k];
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
