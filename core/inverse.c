/* One sample of a chain at a time: its step and its inverse. */
#include "inverse.h"

#include <stddef.h>

long hystmpc_single_lay_out(single_chain *c, const int *chain, const real *kept, char *memory) {
    char *const begin = memory ? memory + (8 - (size_t)memory % 8) % 8 : NULL;
    const int *place = chain + CHAIN_HEAD + chain[6];
    size_t used = (size_t)chain[0] * sizeof(single_stage);
    c->stages = chain[0], c->stage = (single_stage *)(void *)begin;
    for (int k = 0; k < c->stages; k++, place += CHAIN_STAGE) {
        single_stage one, *s = begin ? c->stage + k : &one;
        hystmpc_code_read(chain + place[0], &s->p);
        if (begin) {
            s->place = place, s->registers = (real *)(void *)(begin + used), s->state = s->registers + s->p.kept;
            for (int i = 0; i < s->p.kept; i++) s->registers[i] = kept[place[4] + i];
        }
        used += (size_t)s->p.single * sizeof(real);
    }
    c->last = begin ? (real *)(void *)(begin + used) : NULL;
    return (long)(used + 2 * (size_t)chain[1] * sizeof(real)) + 16;
}

long hystmpc_chain_single_bytes(const int *chain) {
    single_chain c;
    return hystmpc_single_lay_out(&c, chain, NULL, NULL);
}

void hystmpc_single_set(const single_chain *c, const real *x) {
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        for (int i = 0; i < s->p.states; i++) s->state[i] = x[s->place[2] + i];
        hystmpc_code_single(s->p.code[PHASE_FIXED], s->p.length[PHASE_FIXED], s->registers);
    }
}

real hystmpc_single_angle(const single_chain *c, real u, real *slope) {
    *slope = R(1.0);
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        s->state[s->p.states] = u;
        hystmpc_code_moving(&s->p, s->registers);
        *slope = s->p.results[0] < 0 ? R(0.0) : *slope * s->registers[s->p.results[0]];
        u = s->registers[s->p.results[1]];
    }
    return u;
}

void hystmpc_single_move(const single_chain *c, real *x) {
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        hystmpc_code_single(s->p.code[PHASE_REST], s->p.length[PHASE_REST], s->registers);
        for (int i = 0; i < s->p.states; i++) x[s->place[2] + i] = s->registers[s->p.results[1 + s->p.outputs + i]];
    }
}

real hystmpc_chain_step(const int *chain, const real *kept, real *x, real u, char *memory) {
    single_chain c;
    real slope;
    hystmpc_single_lay_out(&c, chain, kept, memory);
    hystmpc_single_set(&c, x);
    const real angle = hystmpc_single_angle(&c, u, &slope);
    hystmpc_single_move(&c, x);
    return angle;
}

enum { INVERSE_ROUNDS = 200 };

/* Numbers of the inverse: the angle may miss by the first, the bracket shrinks to the second. */
#if HYSTMPC_SINGLE
#define INVERSE_MISS R(1e-6)
#define INVERSE_NARROW R(1e-6)
#else
#define INVERSE_MISS R(1e-11)
#define INVERSE_NARROW R(1e-13)
#endif

real hystmpc_single_command(const single_chain *c, real wanted, real low, real high, real last) {
    const real ends[2] = {low, high};
    int tried[2] = {0, 0};
    real u = least(most(last, low), high);
    const real tolerance = INVERSE_MISS * most(R(1.0), absolute(wanted));
    for (int round = 0; round < INVERSE_ROUNDS; round++) {
        real slope;
        const real miss = wanted - hystmpc_single_angle(c, u, &slope);
        const int up = miss > R(0.0);
        if (absolute(miss) <= tolerance) break;
        if (up) low = u;
        else high = u;
        if (high - low <= INVERSE_NARROW * most(R(1.0), absolute(high))) break;
        /* On a flat branch, or where an end of the range is the answer, Newton points outside: the end itself is tried
         * before the bracket is halved, and Newton goes on from there. */
        const real newton = slope > R(0.0) ? u + miss / slope : high + R(1.0), end = up ? high : low;
        if (low < newton && newton < high) {
            u = newton;
        } else if (!tried[up] && end == ends[up]) {
            tried[up] = 1;
            u = end;
        } else {
            u = R(0.5) * (low + high);
        }
    }
    return u;
}

real hystmpc_chain_command_for(const int *chain, const real *kept, const real *x, real wanted, real low, real high,
                               real last, char *memory) {
    single_chain c;
    hystmpc_single_lay_out(&c, chain, kept, memory);
    hystmpc_single_set(&c, x);
    return hystmpc_single_command(&c, wanted, low, high, last);
}

#undef INVERSE_MISS
#undef INVERSE_NARROW
