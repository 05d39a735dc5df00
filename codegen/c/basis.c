/* The basis of the learned part: travel behind a drive, its plays, dead zones and slow followers, and their slopes. */
#include "internal.h"

#if HYSTMPC_LEARNS

enum { PLAYS = HYSTMPC_PLAYS, ZONES = HYSTMPC_ZONES, CREEPS = HYSTMPC_CREEPS, WEIGHTED = HYSTMPC_WEIGHTED };

static const real radii[HYSTMPC_PLAYS] = HYSTMPC_RADII;
static const real zones[HYSTMPC_ZONES] = HYSTMPC_ZONE_STARTS;
static const real creeps[HYSTMPC_CREEPS] = HYSTMPC_CREEP_SHARES;

/* Memories (travel, plays, slow followers) one sample later under the delayed command x. So many stand abreast, number
 * beside number; each has its own share of the way that the travel goes in a sample. */
HYSTMPC_LOCAL void advance_memory(real *memory, int abreast, real x, const real *shares) {
    for (int n = 0; n < abreast; n++) {
        memory[n] += shares[n] * (x - memory[n]);
        const real v = memory[n];
        real *play = memory + abreast + n, *creep = play + PLAYS * abreast;
        for (int i = 0; i < PLAYS; i++)
            play[i * abreast] = least(most(play[i * abreast], v - radii[i]), v + radii[i]);
        for (int j = 0; j < CREEPS; j++) creep[j * abreast] += creeps[j] * (v - creep[j * abreast]);
    }
}

/* Features of memories; `before` is the travel one sample ago, v0 and side where the device started. */
HYSTMPC_LOCAL void features(const real *memory, const real *before, int abreast, real v0, real side, real *out) {
    for (int n = 0; n < abreast; n++) {
        const real v = memory[n], *play = memory + abreast + n, *creep = play + PLAYS * abreast;
        int at = n;
        out[at] = v - v0;
        for (int i = 0; i < PLAYS; i++) out[at += abreast] = play[i * abreast] - v0 - side * radii[i];
        for (int i = 0; i < ZONES; i++)
            out[at += abreast] = most(v - zones[i], R(0.0)) - most(v0 - zones[i], R(0.0));
        for (int i = PLAYS - WEIGHTED; i < PLAYS; i++)
            out[at += abreast] = (play[i * abreast] - v) * v - side * radii[i] * v0;
        for (int j = 0; j < CREEPS; j++) out[at += abreast] = v - creep[j * abreast];
        out[at + abreast] = (v - before[n]) * HYSTMPC_PACE * HYSTMPC_RATE_S;
    }
}

static real share_of_range(real u) { return (u - HYSTMPC_RANGE_LOW) / HYSTMPC_RANGE_SPAN; }

/* The command that acts on the basis in sample k of a plan. */
static real acting_command(const hystmpc_state *s, const real *commands, int k) {
    return k < s->delay ? s->queue[s->delay - 1 - k] : share_of_range(commands[k - s->delay]);
}

/* angles <- m + w_c (m - m_0) + sum_i w_i f_i along a plan; the weights stand still. */
HYSTMPC_LOCAL void add_learned(const hystmpc_state *s, const real *commands, int samples, real *angles) {
    real now[HYSTMPC_MEMORY], f[HYSTMPC_WEIGHTS];
    copy(s->memory, now, HYSTMPC_MEMORY);
    for (int k = 0; k < samples; k++) {
        const real before = now[0];
        advance_memory(now, 1, acting_command(s, commands, k), &s->share);
        features(now, &before, 1, s->start[0], s->start[1], f);
        real total = s->weights[0] * (angles[k] - s->start[2]);
        for (int i = 0; i < HYSTMPC_WEIGHTS - 1; i++) total += s->weights[1 + i] * f[i];
        angles[k] += total;
    }
}

/* Derivatives of a memory by the commands of a plan, one sample later: rows of the work space, the last one that of the
 * travel one sample ago. A play at its edge counts as driven. */
static void advance_slopes(real (*by)[HYSTMPC_HORIZON], const real *before, const real *now, int acting, real share) {
    const real v = now[0];
    for (int j = 0; j <= acting; j++) {
        by[HYSTMPC_MEMORY][j] = by[0][j];
        by[0][j] *= R(1.0) - share;
    }
    if (acting >= 0) by[0][acting] = share;
    for (int i = 0; i < PLAYS; i++) {
        if (v - radii[i] >= before[1 + i] - HYSTMPC_EDGE || v + radii[i] <= before[1 + i] + HYSTMPC_EDGE) {
            for (int j = 0; j <= acting; j++) by[1 + i][j] = by[0][j];
        }
    }
    for (int c = 0; c < CREEPS; c++) {
        real *row = by[1 + PLAYS + c];
        for (int j = 0; j <= acting; j++) row[j] += creeps[c] * (by[0][j] - row[j]);
    }
}

/* Derivatives of sum_i w_i f_i by the memory and by the travel one sample ago. */
static void slopes_by_memory(const real *now, const real *weights, real *out) {
    const real v = now[0];
    fill(out, R(0.0), HYSTMPC_MEMORY + 1);
    out[0] = weights[1];
    for (int i = 0; i < PLAYS; i++) out[1 + i] = weights[2 + i];
    int at = 2 + PLAYS;
    for (int i = 0; i < ZONES; i++)
        if (v > zones[i]) out[0] += weights[at + i];
    at += ZONES;
    for (int i = 0; i < WEIGHTED; i++) {
        const int play = 1 + PLAYS - WEIGHTED + i;
        out[play] += weights[at + i] * v;
        out[0] += weights[at + i] * (now[play] - R(2.0) * v);
    }
    at += WEIGHTED;
    for (int c = 0; c < CREEPS; c++) {
        out[0] += weights[at + c];
        out[1 + PLAYS + c] -= weights[at + c];
    }
    const real rate = weights[HYSTMPC_WEIGHTS - 1] * HYSTMPC_PACE * HYSTMPC_RATE_S;
    out[0] += rate;
    out[HYSTMPC_MEMORY] -= rate;
}

/* The Jacobian of the model in the work space <- that of the whole. */
HYSTMPC_LOCAL void add_slopes(hystmpc_work *w, const hystmpc_state *s, const real *commands) {
    real(*by)[HYSTMPC_HORIZON] = w->moving[0];
    real now[HYSTMPC_MEMORY], before[HYSTMPC_MEMORY], slopes[HYSTMPC_MEMORY + 1];
    copy(s->memory, now, HYSTMPC_MEMORY);
    for (int i = 0; i <= HYSTMPC_MEMORY; i++) fill(by[i], R(0.0), H);
    for (int k = 0; k < H; k++) {
        copy(now, before, HYSTMPC_MEMORY);
        advance_memory(now, 1, acting_command(s, commands, k), &s->share);
        advance_slopes(by, before, now, k - s->delay, s->share);
        slopes_by_memory(now, s->weights, slopes);
        for (int j = 0; j <= k; j++) {
            real value = w->jacobian[k][j] * HYSTMPC_RANGE_SPAN * (R(1.0) + s->weights[0]);
            for (int i = 0; i <= HYSTMPC_MEMORY; i++) value += slopes[i] * by[i][j];
            w->jacobian[k][j] = value / HYSTMPC_RANGE_SPAN;
        }
    }
}

#endif
