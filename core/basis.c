/* A learned part along a plan, and its slopes; the basis itself is in the header. */
#include "basis.h"

enum {
    BASIS_MEMORY = HYSTMPC_MEMORY,
    BASIS_PLAYS = HYSTMPC_PLAYS,
    BASIS_WEIGHTED = HYSTMPC_WEIGHTED,
    BASIS_CREEPS = HYSTMPC_CREEPS
};

#if HYSTMPC_SINGLE
#define BASIS_EDGE R(1e-6) /* so close to its edge a play counts as driven */
#else
#define BASIS_EDGE R(1e-12)
#endif

/* The command that acts on the basis in sample k of a plan. */
static real acting_command(const hystmpc_basis *b, const hystmpc_learned *s, const real *commands, int k, int delay) {
    return k < delay ? s->queue[delay - 1 - k] : hystmpc_share_of_range(b, commands[k - delay]);
}

HYSTMPC_LOCAL void hystmpc_add_learned(const hystmpc_basis *b, const hystmpc_learned *s, const real *commands,
                                       int samples, real *angles) {
    const int delay = hystmpc_delay_of(s);
    real now[HYSTMPC_MEMORY], f[HYSTMPC_FEATURES];
    for (int i = 0; i < BASIS_MEMORY; i++) now[i] = s->memory[i];
    for (int k = 0; k < samples; k++) {
        const real before = now[0];
        hystmpc_advance_memory(b, now, 1, acting_command(b, s, commands, k, delay), &s->share);
        hystmpc_features(b, now, &before, 1, s->start[0], s->start[1], f);
        real total = s->weights[0] * (angles[k] - s->start[2]);
        for (int i = 0; i < HYSTMPC_FEATURES; i++) total += s->weights[1 + i] * f[i];
        angles[k] += total;
    }
}

/* Derivatives of a memory by the commands of a plan, one sample later, in rows (MEMORY + 1, samples); the last row is
 * that of the travel one sample ago. `acting`: number of the command that acts now; negative where none does yet. */
static void advance_slopes(const hystmpc_basis *b, real *by, int samples, const real *before, const real *now,
                           int acting, real share) {
    const real v = now[0];
    real *old = by + BASIS_MEMORY * samples;
    for (int j = 0; j <= acting; j++) {
        old[j] = by[j];
        by[j] *= R(1.0) - share;
    }
    if (acting >= 0) by[acting] = share;
    for (int i = 0; i < BASIS_PLAYS; i++) {
        const real r = hystmpc_radii[i];
        if (v - r >= before[1 + i] - BASIS_EDGE || v + r <= before[1 + i] + BASIS_EDGE) {
            real *row = by + (1 + i) * samples;
            for (int j = 0; j <= acting; j++) row[j] = by[j];
        }
    }
    for (int c = 0; c < BASIS_CREEPS; c++) {
        real *row = by + (1 + BASIS_PLAYS + c) * samples;
        for (int j = 0; j <= acting; j++) row[j] += b->creeps[c] * (by[j] - row[j]);
    }
}

/* Derivatives of sum_i w_i f_i by the memory and by the travel one sample ago (MEMORY + 1). */
static void slopes_by_memory(const hystmpc_basis *b, const real *now, const real *weights, real *out) {
    const real v = now[0];
    for (int i = 0; i <= BASIS_MEMORY; i++) out[i] = R(0.0);
    out[0] = weights[1];
    for (int i = 0; i < BASIS_PLAYS; i++) out[1 + i] = weights[2 + i];
    const real *weight = weights + 2 + BASIS_PLAYS;
    for (int i = 0; i < HYSTMPC_ZONES; i++, weight++)
        if (v > hystmpc_zones[i]) out[0] += *weight;
    for (int play = 1 + BASIS_PLAYS - BASIS_WEIGHTED; play <= BASIS_PLAYS; play++, weight++) {
        out[play] += *weight * v;
        out[0] += *weight * (now[play] - R(2.0) * v);
    }
    for (int c = 0; c < BASIS_CREEPS; c++, weight++) {
        out[0] += *weight;
        out[1 + BASIS_PLAYS + c] -= *weight;
    }
    const real rate = *weight * b->pace * HYSTMPC_RATE_S;
    out[0] += rate;
    out[BASIS_MEMORY] -= rate;
}

HYSTMPC_LOCAL void hystmpc_add_slopes(const hystmpc_basis *b, const hystmpc_learned *s, const real *commands,
                                      int samples, real *jacobian, real *work) {
    real now[HYSTMPC_MEMORY], before[HYSTMPC_MEMORY], slopes[HYSTMPC_MEMORY + 1];
    real *by = work, *sum = work + (BASIS_MEMORY + 1) * samples;
    const int delay = hystmpc_delay_of(s);
    for (int i = 0; i < BASIS_MEMORY; i++) now[i] = s->memory[i];
    for (int i = 0; i < (BASIS_MEMORY + 1) * samples; i++) by[i] = R(0.0);
    for (int k = 0; k < samples; k++) {
        for (int i = 0; i < BASIS_MEMORY; i++) before[i] = now[i];
        hystmpc_advance_memory(b, now, 1, acting_command(b, s, commands, k, delay), &s->share);
        advance_slopes(b, by, samples, before, now, k - delay, s->share);
        slopes_by_memory(b, now, s->weights, slopes);
        real *row = jacobian + k * samples;
        for (int j = 0; j <= k; j++) sum[j] = R(0.0);
        for (int i = 0; i <= BASIS_MEMORY; i++)
            for (int j = 0; j <= k; j++) sum[j] += slopes[i] * by[i * samples + j];
        for (int j = 0; j <= k; j++) row[j] = (R(1.0) + s->weights[0]) * row[j] + sum[j] / b->span;
    }
}

#undef BASIS_EDGE
