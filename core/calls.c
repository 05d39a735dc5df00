/* What Python calls: arrays unpacked, then the functions that an exported controller has too. */
#include "calls.h"

static hystmpc_noise unpacked(const double *numbers) {
    const double *table = numbers + 6;
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

double hystmpc_bank_init(const void *noise, double *bank, double disturbance) {
    const hystmpc_noise n = unpacked(noise);
    return hystmpc_noise_init(&n, bank, disturbance);
}

double hystmpc_bank_correct(const void *noise, double *bank, double offset, double *mean) {
    const hystmpc_noise n = unpacked(noise);
    return hystmpc_noise_correct(&n, bank, offset, mean);
}

double hystmpc_bank_advance(const void *noise, double *bank, double travel, double mean) {
    const hystmpc_noise n = unpacked(noise);
    return hystmpc_noise_advance(&n, bank, travel, mean);
}

void hystmpc_filters_init(const hystmpc_learner *n, double *past, double *filters, double angle, double u, double y) {
    hystmpc_learning_init(n, past, (hystmpc_filters *)(void *)filters, angle, u, y);
}

void hystmpc_filters_advance(const hystmpc_learner *n, double *past, double u) { hystmpc_learning_advance(n, past, u); }

void hystmpc_filters_correct(const hystmpc_learner *n, const double *past, double *filters, double y, double angle,
                             double disturbance) {
    hystmpc_learning_correct(n, past, (hystmpc_filters *)(void *)filters, y, angle, disturbance);
}

void hystmpc_filters_state(const hystmpc_learner *n, const double *past, const double *filters, double *part) {
    const hystmpc_filters *l = (const hystmpc_filters *)(const void *)filters;
    double *angles = part + sizeof(hystmpc_learned) / sizeof(double);
    hystmpc_learning_added(n, past, l, angles, angles);
    hystmpc_learning_state(n, past, l, (hystmpc_learned *)(void *)part);
}

void hystmpc_part_run(const hystmpc_basis *b, const double *part, const double *plans, int count, int samples,
                      double *angles) {
    const hystmpc_learned *s = (const hystmpc_learned *)(const void *)part;
    for (int n = 0; n < count; n++, plans += samples, angles += samples)
        hystmpc_add_learned(b, s, plans, samples, angles);
}

void hystmpc_part_linearise(const hystmpc_basis *b, const double *part, const double *plan, int samples,
                            double *block) {
    const hystmpc_learned *s = (const hystmpc_learned *)(const void *)part;
    double *jacobian = block + samples;
    hystmpc_add_learned(b, s, plan, samples, block);
    hystmpc_add_slopes(b, s, plan, samples, jacobian, jacobian + samples * samples);
}

double hystmpc_part_advance(const hystmpc_basis *b, double *part, double u, double angle) {
    hystmpc_learned *s = (hystmpc_learned *)(void *)part;
    hystmpc_add_learned(b, s, &u, 1, &angle);
    hystmpc_learned_advance(b, s, u);
    return angle;
}

void hystmpc_learning_bytes(int *bytes) {
    bytes[0] = (int)sizeof(hystmpc_basis);
    bytes[1] = (int)sizeof(hystmpc_learner);
    bytes[2] = (int)sizeof(hystmpc_filters);
    bytes[3] = (int)sizeof(hystmpc_learned);
}
