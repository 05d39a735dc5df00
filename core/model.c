/* A predictor with what is learned on top of it; see model.h. */
#include "linear.h"
#include "model.h"
#include "room.h"

enum {
    MODEL_LEARNED = (int)(sizeof(hystmpc_learned) / sizeof(real)), /* numbers of a learned part */
    MODEL_ROUNDS = 2,                                              /* of the fixed point along a preview */
    MODEL_NO_INVERSE = 1
};

int hystmpc_model_states(const void *model) {
    const hystmpc_model *const m = model;
    return m->predictor->states + (m->learner ? MODEL_LEARNED : 0);
}

long hystmpc_model_bytes(const void *model, int rows, int samples) {
    const hystmpc_model *const m = model;
    const int count = rows < 1 ? 1 : rows;
    const long run = hystmpc_predictor_bytes(m->predictor, count, samples);
    const long follow = m->inverse ? hystmpc_inverse_bytes(m->inverse, m->predictor, samples) : 0L;
    return ROOM_LINE + longer(run, follow) + (HYSTMPC_MEMORY + 2L + 2L) * room_for(samples);
}

/* The learned part of a state. */
static const hystmpc_learned *model_part(const hystmpc_model *m, const real *x) {
    return (const hystmpc_learned *)(const void *)(x + m->predictor->states);
}

int hystmpc_model_acts(const void *model, const real *x) {
    const hystmpc_model *const m = model;
    int acts = 0;
    if (m->learner)
        for (int i = 0; i < HYSTMPC_WEIGHTS; i++) acts |= model_part(m, x)->weights[i] != R(0.0);
    return acts;
}

int hystmpc_model_advance(const void *model, real *x, real u, real *theta, char *room) {
    const hystmpc_model *const m = model;
    const int failed = hystmpc_predictor_advance(m->predictor, x, u, theta, room);
    if (failed || !m->learner) return failed;
    hystmpc_learned *const part = (hystmpc_learned *)(void *)(x + m->predictor->states);
    if (hystmpc_model_acts(m, x)) hystmpc_add_learned(&m->learner->basis, part, &u, 1, theta);
    hystmpc_learned_advance(&m->learner->basis, part, u);
    return 0;
}

int hystmpc_model_run(const void *model, const real *x, int rows, int samples, const real *plans, real *angles,
                      char *room) {
    const hystmpc_model *const m = model;
    const int failed = hystmpc_predictor_run(m->predictor, x, rows, samples, plans, angles, room);
    if (failed || !hystmpc_model_acts(m, x)) return failed;
    for (int n = 0; n < rows; n++, plans += samples, angles += samples)
        hystmpc_add_learned(&m->learner->basis, model_part(m, x), plans, samples, angles);
    return 0;
}

int hystmpc_model_linearise(const void *model, const real *x, int samples, const real *plan, real *angles,
                            real *jacobian, char *room) {
    const hystmpc_model *const m = model;
    const int failed = hystmpc_predictor_linearise(m->predictor, x, samples, plan, angles, jacobian, room);
    if (failed || !hystmpc_model_acts(m, x)) return failed;
    real *const work = (real *)(void *)room_begin(room);
    hystmpc_add_learned(&m->learner->basis, model_part(m, x), plan, samples, angles);
    hystmpc_add_slopes(&m->learner->basis, model_part(m, x), plan, samples, jacobian, work);
    return 0;
}

/* What is learned along a plan (H), as a difference of angles; `angles` (H) are room. */
static int model_learned(const hystmpc_model *m, const real *x, int samples, const real *plan, real *learned,
                         real *angles, char *room) {
    const int failed = hystmpc_predictor_run(m->predictor, x, 1, samples, plan, angles, room);
    if (failed) return failed;
    copy(angles, learned, samples);
    hystmpc_add_learned(&m->learner->basis, model_part(m, x), plan, samples, learned);
    for (int k = 0; k < samples; k++) learned[k] -= angles[k];
    return 0;
}

int hystmpc_model_command(const void *model, const real *x, real theta, real u_last, real *u, char *room) {
    const hystmpc_model *const m = model;
    if (!m->inverse) return MODEL_NO_INVERSE;
    if (hystmpc_model_acts(m, x)) {
        real learned = R(0.0), angle;
        const int failed = model_learned(m, x, 1, &u_last, &learned, &angle, room);
        if (failed) return failed;
        theta -= learned;
    }
    return hystmpc_inverse_command(m->inverse, x, m->predictor->states, theta, u_last, u, room);
}

int hystmpc_model_follow(const void *model, const real *x, const real *wanted, int samples, real u_last,
                         const real *bounds, real *plans, char *room) {
    const hystmpc_model *const m = model;
    if (!m->inverse) return MODEL_NO_INVERSE;
    if (!hystmpc_model_acts(m, x))
        return hystmpc_inverse_follow(m->inverse, m->predictor, x, wanted, samples, u_last, bounds, plans, room);
    room = room_begin(room);
    real *const goal = room_take(&room, samples), *const angles = room_take(&room, samples);
    fill(plans + samples, u_last, samples);
    for (int round = 0; round <= MODEL_ROUNDS; round++) {
        int failed = model_learned(m, x, samples, plans + samples, goal, angles, room);
        if (failed) return failed;
        for (int k = 0; k < samples; k++) goal[k] = wanted[k] - goal[k];
        failed = hystmpc_inverse_follow(m->inverse, m->predictor, x, goal, samples, u_last, bounds, plans, room);
        if (failed) return failed;
    }
    return 0;
}
