/* What Python calls: arrays unpacked, then the functions that an exported controller has too. */
#include "calls.h"

static hystmpc_noise noise_of_numbers(const real *numbers) {
    const real *table = numbers + 6;
    hystmpc_noise n;
    n.sensors = (int)numbers[0];
    n.drifts = (int)numbers[1];
    n.motions = (int)numbers[2];
    n.switching = numbers[3];
    n.most_gain = numbers[4];
    n.limit = numbers[5];
    n.sensor_variances = table;
    n.drift_variances = table += n.sensors;
    n.motion_variances = table += n.drifts;
    n.by_sensor = table += n.motions;
    n.by_model = table += n.sensors;
    n.first_variances = table += n.drifts * n.motions;
    n.most_variances = table + n.drifts * n.motions;
    return n;
}

real hystmpc_bank_init(const void *noise, real *bank, real disturbance) {
    const hystmpc_noise n = noise_of_numbers(noise);
    return hystmpc_noise_init(&n, bank, disturbance);
}

real hystmpc_bank_correct(const void *noise, real *bank, real offset, real *mean) {
    const hystmpc_noise n = noise_of_numbers(noise);
    return hystmpc_noise_correct(&n, bank, offset, mean);
}

real hystmpc_bank_advance(const void *noise, real *bank, real travel, real mean) {
    const hystmpc_noise n = noise_of_numbers(noise);
    return hystmpc_noise_advance(&n, bank, travel, mean);
}

void hystmpc_filters_init(const hystmpc_learner *n, real *past, real *filters, real angle, real u, real y) {
    hystmpc_learning_init(n, past, (hystmpc_filters *)(void *)filters, angle, u, y);
}

void hystmpc_filters_advance(const hystmpc_learner *n, real *past, real u) { hystmpc_learning_advance(n, past, u); }

void hystmpc_filters_correct(const hystmpc_learner *n, const real *past, real *filters, real y, real angle,
                             real disturbance) {
    hystmpc_learning_correct(n, past, (hystmpc_filters *)(void *)filters, y, angle, disturbance);
}

void hystmpc_filters_state(const hystmpc_learner *n, const real *past, const real *filters, real *part) {
    const hystmpc_filters *l = (const hystmpc_filters *)(const void *)filters;
    real *angles = part + sizeof(hystmpc_learned) / sizeof(real);
    hystmpc_learning_added(n, past, l, angles, angles);
    hystmpc_learning_state(n, past, l, (hystmpc_learned *)(void *)part);
}

void hystmpc_learning_bytes(int *bytes) {
    bytes[0] = (int)sizeof(hystmpc_basis);
    bytes[1] = (int)sizeof(hystmpc_learner);
    bytes[2] = (int)sizeof(hystmpc_filters);
    bytes[3] = (int)sizeof(hystmpc_learned);
}
