/* One sample of a chain at a time: its step, its inverse, and the inverse along a preview. */
#include "blocks.h"
#include "follow.h"

#include <stddef.h>

/* One stage of a chain with the registers of its step. */
typedef struct {
    hystmpc_code p;
    const int *place;
    real *registers, *state;
} single_stage;

/* All stages; a signal of one axis goes from each to the next. */
typedef struct {
    int stages;
    single_stage *stage;
    real *last; /* room behind the registers: two states of the chain */
} single_chain;

/* Lay out the memory of a call and put in the kept values; answers the bytes that it takes. Null for memory: the bytes
 * alone. */
static long single_lay_out(single_chain *c, const int *chain, const real *kept, char *memory) {
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
    return single_lay_out(&c, chain, NULL, NULL);
}

/* Put in the states; what they alone decide is computed. */
static void single_set(const single_chain *c, const real *x) {
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        for (int i = 0; i < s->p.states; i++) s->state[i] = x[s->place[2] + i];
        hystmpc_code_single(s->p.code[PHASE_FIXED], s->p.length[PHASE_FIXED], s->registers);
    }
}

/* The angle at command u and its derivative, in a state that has been set. */
static real single_angle(const single_chain *c, real u, real *slope) {
    *slope = R(1.0);
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        s->state[s->p.states] = u;
        hystmpc_code_single(s->p.code[PHASE_MOVING], s->p.length[PHASE_MOVING], s->registers);
        *slope = s->p.results[0] < 0 ? R(0.0) : *slope * s->registers[s->p.results[0]];
        u = s->registers[s->p.results[1]];
    }
    return u;
}

/* The state one sample after the command at which the angle has been computed last. */
static void single_move(const single_chain *c, real *x) {
    for (const single_stage *s = c->stage; s < c->stage + c->stages; s++) {
        hystmpc_code_single(s->p.code[PHASE_REST], s->p.length[PHASE_REST], s->registers);
        for (int i = 0; i < s->p.states; i++) x[s->place[2] + i] = s->registers[s->p.results[1 + s->p.outputs + i]];
    }
}

real hystmpc_chain_step(const int *chain, const real *kept, real *x, real u, char *memory) {
    single_chain c;
    real slope;
    single_lay_out(&c, chain, kept, memory);
    single_set(&c, x);
    const real angle = single_angle(&c, (real)u, &slope);
    single_move(&c, x);
    return (real)angle;
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

/* The command of a state that has been set. */
static real single_command(const single_chain *c, real wanted, real low, real high, real last) {
    const real ends[2] = {low, high};
    int tried[2] = {0, 0};
    real u = least(most(last, low), high);
    const real tolerance = INVERSE_MISS * most(R(1.0), absolute(wanted));
    for (int round = 0; round < INVERSE_ROUNDS; round++) {
        real slope;
        const real miss = wanted - single_angle(c, u, &slope);
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

real hystmpc_chain_command_for(const int *chain, const real *kept, const real *x, real wanted, real low,
                                 real high, real last, char *memory) {
    single_chain c;
    single_lay_out(&c, chain, kept, memory);
    single_set(&c, x);
    return (real)single_command(&c, (real)wanted, (real)low, (real)high, (real)last);
}

/* What runs beside one another along a preview: the command's memory with and without the rate limit. */
typedef struct {
    real *state, *network; /* of the chain; of the network, if there is one */
    real last, u, off;     /* off: how much the chain's angle exceeds the network's */
} follower;

static long follow_numbers(const hystmpc_network *network) {
    return network ? 2L * hystmpc_network_state(network) + hystmpc_network_room(network, 1) + 4 : 0L;
}

long hystmpc_follow_bytes(const int *chain, const hystmpc_network *network) {
    return hystmpc_chain_single_bytes(chain) + follow_numbers(network) * (long)sizeof(real) + 64;
}

/* One sample under the command f->u. */
static void follow_on(const single_chain *c, const hystmpc_network *network, follower *f, real *work) {
    real slope, theta = R(0.0);
    const real angle = single_angle(c, f->u, &slope);
    single_move(c, f->state);
    f->last = f->u;
    if (!network) return;
    hystmpc_network_sample(network, f->network, 1, &f->u, &theta, work);
    f->off = angle - theta;
}

void hystmpc_follow(const int *chain, const real *kept, const hystmpc_network *network, const real *x,
                    const real *wanted, int samples, real last, const real *bounds, const real *inverted, real *plans,
                    char *memory) {
    single_chain c;
    const int size = chain[1], hidden = network ? hystmpc_network_state(network) : 0;
    const real low = bounds[0], high = bounds[1], reach = bounds[2];
    char *const behind = memory + single_lay_out(&c, chain, kept, memory);
    real *const memories = (real *)(behind + (64 - (size_t)behind % 64) % 64), *const work = memories + 2 * hidden;
    const real *const beside = network ? x + hidden + 1 : x;
    follower f[2];
    int rows = 1;
    f[0].state = c.last, f[1].state = c.last + size, f[0].network = memories, f[1].network = memories + hidden;
    f[0].last = (real)last, f[0].off = network ? beside[size] - x[hidden] : R(0.0);
    for (int i = 0; i < size; i++) f[0].state[i] = beside[i];
    for (int i = 0; i < hidden; i++) f[0].network[i] = x[i];
    for (int k = 0; k < samples; k++) {
        for (int row = 0; row < rows; row++) {
            follower *const now = f + row;
            /* Beyond the rate limit nothing has to be looked for: the angle does not fall with the command. */
            const real near = row ? most(now->last - reach, inverted[0]) : inverted[0];
            const real far = row ? least(now->last + reach, inverted[1]) : inverted[1];
            single_set(&c, now->state);
            const real goal = single_command(&c, wanted[k] + now->off, near, far, now->last);
            now->u = least(most(is_finite(goal) ? goal : now->last, low), high);
            if (rows == 1 && absolute(now->u - now->last) > reach) {
                rows = 2; /* from here on two memories; the second one goes as far as the limit allows */
                for (int i = 0; i < size; i++) f[1].state[i] = f[0].state[i];
                for (int i = 0; i < hidden; i++) f[1].network[i] = f[0].network[i];
                f[1].last = f[0].last, f[1].off = f[0].off;
            }
            if (row) now->u = least(most(now->u, now->last - reach), now->last + reach);
            follow_on(&c, network, now, work);
        }
        plans[k] = f[0].u;
        plans[samples + k] = f[rows - 1].u;
    }
}

#undef INVERSE_MISS
#undef INVERSE_NARROW
