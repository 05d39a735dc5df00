/* State of a predictor at rest. */
#include "at_rest.h"

#include "blocks.h"
#include "rest_search.h"
#include "room.h"

/* Step back from an edge of the core's range and step of a difference quotient [deg]. */
#if HYSTMPC_SINGLE
#define REST_WITHIN R(1e-2)
#define REST_NUDGE R(1e-2)
#else
#define REST_WITHIN R(1e-6)
#define REST_NUDGE R(1e-6)
#endif

/* A chain that is to come to rest under the command u. */
typedef struct {
    const hystmpc_rest_rule *rule;
    real u;
    real *x;
    real *room; /* of one stage */
} chain_at_rest;

/* Numbers of room for one stage at rest, and for one step of it. */
static long rest_numbers(const int *chain) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    long numbers = 0;
    for (int k = 0; k < chain[0]; k++, place += CHAIN_STAGE) {
        hystmpc_code p;
        hystmpc_code_read(chain + place[0], &p);
        numbers = longer(numbers, p.single);
        if (place[1] >= 0) numbers = longer(numbers, hystmpc_chain_rest_room(chain, k));
    }
    return numbers;
}

/* One stage at rest at the input v, where it shows `seen`; answers its output in the next sample. */
static real rest_stage(const chain_at_rest *c, int stage, real v, real seen) {
    const hystmpc_rest_rule *r = c->rule;
    const int *place = r->chain + CHAIN_HEAD + r->chain[6] + CHAIN_STAGE * stage;
    real *x = c->x + place[2], *registers = c->room;
    hystmpc_code p;
    if (place[1] >= 0)
        hystmpc_chain_rest(r->chain, r->constants, stage, 1, &v, x, &seen, x, r->parameters + place[3], 1, 0, x, x, x,
                           c->room);
    hystmpc_code_read(r->chain + place[0], &p);
    for (int i = 0; i < p.kept; i++) registers[i] = r->kept[place[4] + i];
    for (int i = 0; i < p.states; i++) registers[p.kept + i] = x[i];
    registers[p.kept + p.states] = v;
    hystmpc_code_single(p.code[PHASE_FIXED], p.length[PHASE_FIXED], registers);
    hystmpc_code_moving(&p, registers);
    return registers[p.results[1]];
}

/* The chain with the core at the angle a; answers what the whole shows, and what the core does. */
static real rest_chain(const chain_at_rest *c, real a, real *core) {
    real signal = c->u;
    for (int k = 0; k < c->rule->chain[0]; k++) {
        signal = rest_stage(c, k, signal, k == c->rule->core ? a : signal);
        if (k == c->rule->core) *core = signal;
    }
    return signal;
}

/* The core at the angle at which the whole shows y, or nearest to it. */
static void settle(const chain_at_rest *c, real y) {
    rest_search s = rest_search_from(y);
    real core, other, left = y - rest_chain(c, s.at, &core);
    for (int k = 0; k < REST_MOST && s.open; k++) {
        const real nudge = s.within ? s.edge * REST_NUDGE : REST_NUDGE;
        const real slope = (rest_chain(c, s.at + nudge, &other) - (y - left)) / nudge;
        rest_search_move(&s, left, slope, core, REST_WITHIN);
        left = y - rest_chain(c, s.at, &core);
    }
}

long hystmpc_at_rest_bytes(const void *rule, const void *predictor) {
    const hystmpc_rest_rule *r = rule;
    const hystmpc_predictor *p = predictor;
    if (r->kind == HYSTMPC_RESTS)
        return longer(hystmpc_at_rest_bytes(r->first, p->first), hystmpc_at_rest_bytes(r->second, p->second));
    const long bytes = hystmpc_predictor_bytes(p, 1, 1);
    return r->kind == HYSTMPC_SETTLED ? bytes + room_for(rest_numbers(r->chain)) + ROOM_LINE : bytes;
}

/* Both parts of a predictor; a companion's state has the angle behind each. */
static int rest_parts(const hystmpc_rest_rule *r, const hystmpc_predictor *p, real y, real u, real *x, char *room) {
    const int shows = p->kind == HYSTMPC_ACCOMPANIED, drives = p->kind == HYSTMPC_SERIES;
    const int behind = p->first->states + shows;
    if (shows) x[behind - 1] = x[p->states - 1] = y;
    const int failed = hystmpc_at_rest(r->first, p->first, drives ? u : y, u, x, room);
    if (failed) return failed;
    return hystmpc_at_rest(r->second, p->second, p->kind == HYSTMPC_PARALLEL ? R(0.0) : y, u, x + behind, room);
}

int hystmpc_at_rest(const void *rule, const void *predictor, real y, real u, real *x, char *room) {
    const hystmpc_rest_rule *r = rule;
    const hystmpc_predictor *p = predictor;
    real theta;
    int failed = 0;
    if (r->kind == HYSTMPC_RESTS) return rest_parts(r, p, y, u, x, room);
    if (r->kind == HYSTMPC_SETTLED) {
        room = room_begin(room);
        const chain_at_rest c = {r, u, x, room_take(&room, rest_numbers(r->chain))};
        settle(&c, y);
    } else {
        for (int i = 0; i < p->states; i++) x[i] = r->offset[i] + r->by_angle[i] * y + r->by_command[i] * u;
    }
    for (int k = 0; k < r->held && !failed; k++) failed = hystmpc_predictor_advance(p, x, u, &theta, room);
    return failed;
}

#undef REST_WITHIN
#undef REST_NUDGE
