/* The basis of a learned part: the response of a drive and a hysteresis operator with free weights to the command,
 *
 *     theta = m + w_c (m - m_0) + sum_i w_i f_i(v),   v = lag_tau(u(t - D))
 *
 * m is the model's angle, v the travel behind a drive with the lag tau and the delay D, a share of the command's range.
 * The f_i are differences from the start: v itself, plays of v (a Prandtl-Ishlinskii operator), one-sided dead zones of v
 * (a superposition operator; both Kuhnen, "Modeling, identification and compensation of complex hysteretic
 * nonlinearities", European Journal of Control 9, 2003), plays times v, slow followers of v (creep), and the rate of v,
 * which stands for a drive between two of the grid. */
#ifndef HYSTMPC_BASIS_H
#define HYSTMPC_BASIS_H

#include "hystmpc_core.h"
#include "real.h"

#ifndef HYSTMPC_H /* the header of an exported controller has both */
typedef real hystmpc_real;
#include "learned_state.h"
#endif

/* What the basis knows of a device. */
typedef struct {
    real creeps[HYSTMPC_CREEPS]; /* way that each slow follower goes in a sample, as a share */
    real pace;                   /* samples a second */
    real low, span;              /* least command, range of the commands [command unit] */
} hystmpc_basis;

static const real hystmpc_radii[HYSTMPC_PLAYS] = {R(0.008), R(0.02), R(0.05), R(0.1), R(0.2)};
static const real hystmpc_zones[HYSTMPC_ZONES] = {R(0.05), R(0.1),  R(0.16), R(0.24),
                                                  R(0.34), R(0.46), R(0.6),  R(0.78)}; /* where each begins */
#define HYSTMPC_RATE_S R(0.1) /* unit of the rate of v */

static inline real hystmpc_share_of_range(const hystmpc_basis *b, real u) { return (u - b->low) / b->span; }

/* At rest at the travel v, approached from the side +1 (above) or -1. */
static inline void hystmpc_rest_memory(real *memory, int abreast, real v, real side) {
    for (int i = 0; i < HYSTMPC_MEMORY; i++) {
        const int play = i - 1;
        const real off = 0 <= play && play < HYSTMPC_PLAYS ? side * hystmpc_radii[play] : R(0.0);
        for (int n = 0; n < abreast; n++) memory[i * abreast + n] = v + off;
    }
}

/* Memories (travel, plays, slow followers) one sample later under the delayed command x. So many stand abreast, number
 * beside number; each has its own share of the way that the travel goes in a sample. */
static inline void hystmpc_advance_memory(const hystmpc_basis *b, real *memory, int abreast, real x,
                                          const real *shares) {
    for (int n = 0; n < abreast; n++) {
        memory[n] += shares[n] * (x - memory[n]);
        const real v = memory[n];
        real *play = memory + abreast + n, *creep = play + HYSTMPC_PLAYS * abreast;
        for (int i = 0; i < HYSTMPC_PLAYS; i++)
            play[i * abreast] = least(most(play[i * abreast], v - hystmpc_radii[i]), v + hystmpc_radii[i]);
        for (int j = 0; j < HYSTMPC_CREEPS; j++) creep[j * abreast] += b->creeps[j] * (v - creep[j * abreast]);
    }
}

/* Features of memories; `before` is the travel one sample ago, v0 and side where the device started. */
static inline void hystmpc_features(const hystmpc_basis *b, const real *memory, const real *before, int abreast,
                                    real v0, real side, real *out) {
    for (int n = 0; n < abreast; n++) {
        const real v = memory[n], *play = memory + abreast + n, *creep = play + HYSTMPC_PLAYS * abreast;
        int at = n;
        out[at] = v - v0;
        for (int i = 0; i < HYSTMPC_PLAYS; i++)
            out[at += abreast] = play[i * abreast] - v0 - side * hystmpc_radii[i];
        for (int i = 0; i < HYSTMPC_ZONES; i++)
            out[at += abreast] = most(v - hystmpc_zones[i], R(0.0)) - most(v0 - hystmpc_zones[i], R(0.0));
        for (int i = HYSTMPC_PLAYS - HYSTMPC_WEIGHTED; i < HYSTMPC_PLAYS; i++)
            out[at += abreast] = (play[i * abreast] - v) * v - side * hystmpc_radii[i] * v0;
        for (int j = 0; j < HYSTMPC_CREEPS; j++) out[at += abreast] = v - creep[j * abreast];
        out[at + abreast] = (v - before[n]) * b->pace * HYSTMPC_RATE_S;
    }
}

/* The delay of a learned part [samples]; none where it is no such number. */
static inline int hystmpc_delay_of(const hystmpc_learned *s) {
    return s->delay >= R(0.0) && s->delay <= (real)HYSTMPC_DELAYS ? (int)s->delay : 0;
}

/* A queue of commands one sample later. */
static inline void hystmpc_advance_queue(real *queue, real x) {
    for (int k = HYSTMPC_DELAYS - 1; k > 0; k--) queue[k] = queue[k - 1];
    queue[0] = x;
}

/* A learned part one sample later under the command u. */
static inline void hystmpc_learned_advance(const hystmpc_basis *b, hystmpc_learned *s, real u) {
    const real x = hystmpc_share_of_range(b, u);
    const int delay = hystmpc_delay_of(s);
    hystmpc_advance_memory(b, s->memory, 1, delay > 0 ? s->queue[delay - 1] : x, &s->share);
    hystmpc_advance_queue(s->queue, x);
}

/* angles (samples) <- m + w_c (m - m_0) + sum_i w_i f_i along a plan (samples); the weights stand still. */
HYSTMPC_LOCAL void hystmpc_add_learned(const hystmpc_basis *b, const hystmpc_learned *s, const real *commands,
                                       int samples, real *angles);

/* The model's jacobian (samples, samples) <- that of the whole, along one plan. Work: (HYSTMPC_MEMORY + 2) * samples. */
HYSTMPC_LOCAL void hystmpc_add_slopes(const hystmpc_basis *b, const hystmpc_learned *s, const real *commands,
                                      int samples, real *jacobian, real *work);

#endif
