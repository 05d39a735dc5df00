/* Sampling planners: path integral control (Williams et al., T-RO 2018) and the fit of a slope to samples. */
#include "sampling.h"

#include <float.h>

#if HYSTMPC_SINGLE
#define SAMPLING_LEAST FLT_MIN
#else
#define SAMPLING_LEAST DBL_MIN
#endif

static const real SAMPLING_SMALL = R(1e-12); /* squared distance from the start below which a sample is not used */
static const real SAMPLING_RIDGE = R(1e-6);  /* of the fit, as a share of its normal matrix's trace */

static real sampling_product(const real *a, const real *b, int count) {
    real total = R(0.0);
    for (int k = 0; k < count; k++) total += a[k] * b[k];
    return total;
}

static void sampling_add(real *restrict target, real factor, const real *restrict row, int count) {
    for (int k = 0; k < count; k++) target[k] += factor * row[k];
}

void hystmpc_make_orthogonal(int count, int size, real *normals, real *squares) {
    for (int n = 0; n < count; n++) {
        real *const row = normals + n * size;
        squares[n] = sampling_product(row, row, size);
        for (int k = n - n % size; k < n; k++)
            sampling_add(row, -sampling_product(normals + k * size, row, size) / squares[k], normals + k * size, size);
        const real factor = MATH(sqrt)(squares[n] / sampling_product(row, row, size));
        for (int k = 0; k < size; k++) row[k] *= factor;
    }
}

HYSTMPC_LOCAL void hystmpc_draw_plans(int count, int size, int samples, real *normals, const real *shape,
                                      const real *mean, const real *deviations, int along, real lower, real upper,
                                      real reach, real last, real *plans) {
    hystmpc_make_orthogonal(count, size, normals, plans); /* which are not written yet */
    for (int n = 0; n < count; n++) {
        real *const plan = plans + n * samples;
        fill(plan, R(0.0), samples);
        for (int j = 0; j < size; j++) sampling_add(plan, normals[n * size + j], shape + j * samples, samples);
        for (int k = 0; k < samples; k++) plan[k] = mean[k] + deviations[along ? k : n] * plan[k];
        hystmpc_clip_plan(samples, lower, upper, reach, last, plan);
    }
}

/* matrix X = right (m, H) in place, by matrix = R'R; of `matrix` (m, m) the upper triangle is used. */
static void sampling_solve(real *matrix, real *right, int size, int samples) {
    for (int j = 0; j < size; j++) {
        real *const row = matrix + j * size, *const target = right + j * samples;
        for (int i = 0; i < j; i++) {
            const real factor = -matrix[i * size + j];
            sampling_add(row + j, factor, matrix + i * size + j, size - j);
            sampling_add(target, factor, right + i * samples, samples);
        }
        const real root = MATH(sqrt)(row[j]);
        for (int k = j; k < size; k++) row[k] /= root;
        for (int k = 0; k < samples; k++) target[k] /= root;
    }
    for (int j = size - 1; j >= 0; j--) {
        real *const target = right + j * samples;
        for (int i = j + 1; i < size; i++) sampling_add(target, -matrix[j * size + i], right + i * samples, samples);
        for (int k = 0; k < samples; k++) target[k] /= matrix[j * size + j];
    }
}

void hystmpc_fit_columns(int count, int samples, int size, const real *plans, const real *angles,
                         const real *commands, const real *start, const int *ends, const real *whitening,
                         real *room, real *columns) {
    real *const normal = take(&room, size * size), *const products = take(&room, size * samples);
    real *const z = take(&room, size), *const change = take(&room, samples), trace = R(0.0);
    fill(normal, R(0.0), size * size);
    fill(products, R(0.0), size * samples);
    for (int n = 0; n < count; n++) {
        fill(z, R(0.0), size);
        for (int j = 0; j < size; j++)
            sampling_add(z, plans[n * samples + ends[j]] - commands[ends[j]], whitening + j * size, size);
        for (int k = 0; k < samples; k++) change[k] = angles[n * samples + k] - start[k];
        const real length = most(sampling_product(z, z, size), SAMPLING_SMALL), near = R(1.0) / (length * length);
        for (int j = 0; j < size; j++) {
            sampling_add(normal + j * size + j, near * z[j], z + j, size - j);
            sampling_add(products + j * samples, near * z[j], change, samples);
        }
    }
    for (int j = 0; j < size; j++) trace += normal[j * size + j];
    for (int j = 0; j < size; j++) /* slope 0 if no sample has moved */
        normal[j * size + j] += SAMPLING_RIDGE * trace + SAMPLING_LEAST;
    sampling_solve(normal, products, size, samples);
    for (int i = 0; i < size; i++) {
        fill(change, R(0.0), samples);
        for (int j = 0; j < size; j++) sampling_add(change, whitening[i * size + j], products + j * samples, samples);
        for (int k = 0; k < samples; k++) columns[k * size + i] = change[k];
    }
}

/* The middle one of all numbers, or the mean of both that are; they are sorted on the way (Shell, 1959). */
static real sampling_median(real *values, int count) {
    int gap = 1;
    while (gap < count / 9) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3) {
        for (int i = gap; i < count; i++) {
            const real value = values[i];
            int j = i;
            for (; j >= gap && values[j - gap] > value; j -= gap) values[j] = values[j - gap];
            values[j] = value;
        }
    }
    return count % 2 ? values[count / 2] : R(0.5) * (values[count / 2 - 1] + values[count / 2]);
}

HYSTMPC_LOCAL void hystmpc_weighted_mean(int count, int samples, const real *plans, const real *costs,
                                         real temperature, real *room, real *mean) {
    real lowest = INFINITE, total = R(0.0);
    for (int n = 0; n < count; n++) lowest = least(lowest, costs[n]);
    copy(costs, room, count);
    const real scale = most(temperature * (sampling_median(room, count) - lowest), SAMPLING_LEAST);
    fill(mean, R(0.0), samples);
    for (int n = 0; n < count; n++) {
        const real weight = MATH(exp)((lowest - costs[n]) / scale);
        total += weight;
        sampling_add(mean, weight, plans + n * samples, samples);
    }
    for (int k = 0; k < samples; k++) mean[k] /= total;
}

#undef SAMPLING_LEAST
