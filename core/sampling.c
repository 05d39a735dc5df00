/* Sampling planners: path integral control (Williams et al., T-RO 2018) and the fit of a slope to samples. */
#include "sampling.h"

#include <float.h>

static const double SMALL = 1e-12; /* squared distance from the start below which a sample is not used */
static const double RIDGE = 1e-6;  /* of the fit, as a share of its normal matrix's trace */

enum { PARTS = 5 };

static double product(const double *a, const double *b, int count) {
    double total = 0.0;
    for (int k = 0; k < count; k++) total += a[k] * b[k];
    return total;
}

static void add(double *restrict target, double factor, const double *restrict row, int count) {
    for (int k = 0; k < count; k++) target[k] += factor * row[k];
}

void hystmpc_make_orthogonal(int count, int size, double *normals, double *squares) {
    for (int n = 0; n < count; n++) {
        double *const row = normals + n * size;
        squares[n] = product(row, row, size);
        for (int k = n - n % size; k < n; k++)
            add(row, -product(normals + k * size, row, size) / squares[k], normals + k * size, size);
        const double factor = sqrt(squares[n] / product(row, row, size));
        for (int k = 0; k < size; k++) row[k] *= factor;
    }
}

void hystmpc_draw_plans(int count, int size, int samples, double *normals, const double *shape, const double *mean,
                        const double *deviations, int along, double lower, double upper, double reach, double last,
                        double *plans) {
    hystmpc_make_orthogonal(count, size, normals, plans); /* which are not written yet */
    for (int n = 0; n < count; n++) {
        double *const plan = plans + n * samples;
        fill(plan, 0.0, samples);
        for (int j = 0; j < size; j++) add(plan, normals[n * size + j], shape + j * samples, samples);
        for (int k = 0; k < samples; k++) plan[k] = mean[k] + deviations[along ? k : n] * plan[k];
        hystmpc_clip_plan(samples, lower, upper, reach, last, plan);
    }
}

/* matrix X = right (m, H) in place, by matrix = R'R; of `matrix` (m, m) the upper triangle is used. */
static void solve_normal(double *matrix, double *right, int size, int samples) {
    for (int j = 0; j < size; j++) {
        double *const row = matrix + j * size, *const target = right + j * samples;
        for (int i = 0; i < j; i++) {
            const double factor = -matrix[i * size + j];
            add(row + j, factor, matrix + i * size + j, size - j);
            add(target, factor, right + i * samples, samples);
        }
        const double root = sqrt(row[j]);
        for (int k = j; k < size; k++) row[k] /= root;
        for (int k = 0; k < samples; k++) target[k] /= root;
    }
    for (int j = size - 1; j >= 0; j--) {
        double *const target = right + j * samples;
        for (int i = j + 1; i < size; i++) add(target, -matrix[j * size + i], right + i * samples, samples);
        for (int k = 0; k < samples; k++) target[k] /= matrix[j * size + j];
    }
}

void hystmpc_fit_columns(int count, int samples, int size, const double *plans, const double *angles,
                         const double *commands, const double *start, const int *ends, const double *whitening,
                         double *room, double *columns) {
    double *const normal = take(&room, size * size), *const products = take(&room, size * samples);
    double *const z = take(&room, size), *const change = take(&room, samples), trace = 0.0;
    fill(normal, 0.0, size * size);
    fill(products, 0.0, size * samples);
    for (int n = 0; n < count; n++) {
        fill(z, 0.0, size);
        for (int j = 0; j < size; j++)
            add(z, plans[n * samples + ends[j]] - commands[ends[j]], whitening + j * size, size);
        for (int k = 0; k < samples; k++) change[k] = angles[n * samples + k] - start[k];
        const double length = most(product(z, z, size), SMALL), near = 1.0 / (length * length);
        for (int j = 0; j < size; j++) {
            add(normal + j * size + j, near * z[j], z + j, size - j);
            add(products + j * samples, near * z[j], change, samples);
        }
    }
    for (int j = 0; j < size; j++) trace += normal[j * size + j];
    for (int j = 0; j < size; j++) normal[j * size + j] += RIDGE * trace + DBL_MIN; /* slope 0 if no sample has moved */
    solve_normal(normal, products, size, samples);
    for (int i = 0; i < size; i++) {
        fill(change, 0.0, samples);
        for (int j = 0; j < size; j++) add(change, whitening[i * size + j], products + j * samples, samples);
        for (int k = 0; k < samples; k++) columns[k * size + i] = change[k];
    }
}

int hystmpc_sampled_steps(const void *law, const void *task, int count, const double *plans, const double *angles,
                          const double *whitening, const double *commands, const double *start, int changes,
                          void *room, double *parts) {
    static const double shares[PARTS] = {1.0, 0.6, 0.35, 0.2, 0.1};
    const hystmpc_law *const l = law;
    const hystmpc_task t = hystmpc_task_of(l, task);
    const int samples = l->horizon;
    hystmpc_qp q;
    double *const columns = hystmpc_place_program(l, room, &q), *const behind = columns + samples * l->moves;
    hystmpc_fit_columns(count, samples, l->moves, plans, angles, commands, start, l->ends, whitening, behind, columns);
    hystmpc_build_program(&q, l, &t, commands, start, columns);
    const int answer = hystmpc_solve_qp(&q, changes);
    if (answer < 0) return answer;
    hystmpc_deviation(l, q.primal, behind);
    for (int i = 0; i < PARTS; i++)
        for (int k = 0; k < samples; k++) parts[i * samples + k] = commands[k] + shares[i] * behind[k];
    return answer;
}

/* The middle one of all numbers, or the mean of both that are; they are sorted on the way (Shell, 1959). */
static double median_of(double *values, int count) {
    int gap = 1;
    while (gap < count / 9) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3) {
        for (int i = gap; i < count; i++) {
            const double value = values[i];
            int j = i;
            for (; j >= gap && values[j - gap] > value; j -= gap) values[j] = values[j - gap];
            values[j] = value;
        }
    }
    return count % 2 ? values[count / 2] : 0.5 * (values[count / 2 - 1] + values[count / 2]);
}

void hystmpc_weighted_mean(int count, int samples, const double *plans, const double *costs, double temperature,
                           void *room, double *mean) {
    double lowest = INFINITE, total = 0.0;
    for (int n = 0; n < count; n++) lowest = least(lowest, costs[n]);
    copy(costs, room, count);
    const double scale = most(temperature * (median_of(room, count) - lowest), DBL_MIN);
    fill(mean, 0.0, samples);
    for (int n = 0; n < count; n++) {
        const double weight = exp((lowest - costs[n]) / scale);
        total += weight;
        add(mean, weight, plans + n * samples, samples);
    }
    for (int k = 0; k < samples; k++) mean[k] /= total;
}
