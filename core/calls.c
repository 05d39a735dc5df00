/* What Python calls: arrays unpacked, then the functions that an exported controller has too. */
#include "calls.h"

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
