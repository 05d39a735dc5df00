/* States at rest of a whole chain, with derivatives. */
#include "blocks.h"
#include "rest_search.h"
#include "room.h"

/* Step back from an edge of the core's range [deg]. */
#define SETTLE_WITHIN R(1e-6)

/* Rows n0 ... n0 + count - 1 of a call. The last direction is the core's angle, behind those of the caller. */
typedef struct {
    chain_run r;
    const int *chain;
    const real *constants, *parameters, *u, *y;
    real *seeds; /* (P, D + 1) */
    int core, n0, count;
    real *x, *m;                    /* states at rest (S, G), and derivatives (S, G, D + 1) */
    real *in, *by_in, *at, *by_at;  /* input and output of a stage (G), and derivatives (G, D + 1) */
    real *shown;                    /* angle of the core (G) */
    real *room;                     /* of one stage */
} settling;

/* The signals of a batch as rows: values (G), and derivatives (G, D + 1). */
static void read_signal(const settling *c, int signal, real *value, real *by) {
    const chain_run *r = &c->r;
    for (int n = 0; n < r->abreast; n++) {
        value[n] = r->signal[signal * CHAIN_STRIDE + n];
        for (int q = 0; q < r->directions; q++) {
            const int k = signal * r->directions + q;
            by[n * r->directions + q] = r->begins[k] > 0 ? R(0.0) : r->by[k * CHAIN_STRIDE + n];
        }
    }
}

/* Stage k at rest at its input, the core at the angles `at`; then its output in the next sample. */
static void settle_stage(const settling *c, int k) {
    const chain_run *r = &c->r;
    const chain_stage *s = r->stage + k;
    const int g = r->abreast, d = r->directions, first = s->place[2];
    const int holds = k == c->core && s->p.outputs > 0;
    real *x = c->x + first * g, *m = c->m + first * g * d;
    if (s->p.inputs > 0) read_signal(c, s->wires[0], c->in, c->by_in);
    if (s->place[1] >= 0)
        hystmpc_chain_rest(c->chain, c->constants, k, g, c->in, c->by_in, holds ? c->at : c->in,
                           holds ? c->by_at : c->by_in, c->parameters + s->place[3], 1, d, c->seeds + s->place[3] * d,
                           x, m, c->room);
    for (int i = 0; i < s->p.states; i++)
        for (int n = 0; n < g; n++) {
            s->state[i * (CHAIN_STRIDE + g) + n] = x[i * g + n];
            for (int q = 0; q < d; q++) {
                const real by = m[(i * g + n) * d + q];
                r->moving[((first + i) * d + q) * g + n] = by;
                r->moves[(first + i) * d + q] = (n > 0 && r->moves[(first + i) * d + q]) || by != R(0.0);
            }
        }
    hystmpc_chain_run_stage(s, g, 1, PHASE_BY_PARAMETERS);
    hystmpc_chain_move_stage(r, s, c->seeds, 1);
    if (holds)
        for (int n = 0; n < g; n++) c->shown[n] = r->signal[s->wires[s->p.inputs] * CHAIN_STRIDE + n];
}

/* The whole chain at the present angles of the core. */
static void settle_chain(const settling *c) {
    const chain_run *r = &c->r;
    for (int n = 0; n < r->abreast; n++) r->signal[n] = c->u[c->n0 + smaller(n, c->count - 1)];
    for (int q = 0; q < r->directions; q++) r->begins[q] = HYSTMPC_BLOCK;
    for (int k = 0; k < r->stages; k++) settle_stage(c, k);
}

/* Output of row n, and its derivative by the core's angle. */
static real shown_of(const settling *c, int n) { return c->r.signal[c->r.shown[0] * CHAIN_STRIDE + n]; }

static real slope_of(const settling *c, int n) {
    const int k = c->r.shown[0] * c->r.directions + c->r.directions - 1;
    return c->r.begins[k] > 0 ? R(0.0) : c->r.by[k * CHAIN_STRIDE + n];
}

/* The core of each row at the angle at which the chain shows y, or nearest to it. */
static void settle_rows(const settling *c) {
    rest_search search[CHAIN_MOST];
    int left = c->count;
    for (int n = 0; n < c->count; n++) search[n] = rest_search_from(c->at[n]);
    settle_chain(c);
    for (int round = 0; round < REST_MOST && left > 0; round++) {
        int moved = 0;
        for (int n = 0; n < c->count; n++) {
            rest_search *s = search + n;
            if (!s->open) continue;
            const real miss = c->y[c->n0 + n] - shown_of(c, n);
            if (rest_search_move(s, miss, slope_of(c, n), c->shown[n], SETTLE_WITHIN)) moved = 1;
            c->at[n] = s->at;
            left -= !s->open;
        }
        if (moved) settle_chain(c);
    }
}

/* States of the rows, and their derivatives at the output y: dx/dp - dx/da (dy/dp) / (dy/da), a the core's angle. */
static void store_rows(const settling *c, int rows, real *x, real *m) {
    const chain_run *r = &c->r;
    const int g = r->abreast, d = r->directions, last = d - 1, out = r->shown[0];
    for (int n = 0; n < c->count; n++) {
        const real moves = slope_of(c, n);
        const int leads = !(absolute(moves) < REST_FLAT);
        for (int i = 0; i < r->states; i++) x[i * rows + c->n0 + n] = c->x[i * g + n];
        for (int q = 0; q < last; q++) {
            const real by = r->begins[out * d + q] > 0 ? R(0.0) : r->by[(out * d + q) * CHAIN_STRIDE + n];
            const real turned = leads ? by / moves : R(0.0);
            for (int i = 0; i < r->states; i++) {
                const real *slope = c->m + (i * g + n) * d;
                m[(i * rows + c->n0 + n) * last + q] = slope[q] - slope[last] * turned;
            }
        }
    }
}

/* Lay out the memory of a call behind that of the chain's blocks; answers the bytes. Null for memory: the bytes alone. */
static long settle_lay_out(settling *c, const int *chain, int rows, int directions, char *memory) {
    const long d = directions + 1, g = hystmpc_chain_abreast(rows), states = chain[1];
    const long numbers[8] = {chain[2] * d, states * g, states * g * d, g, g * d, g, g * d, g};
    long used = hystmpc_chain_lay_out(&c->r, chain, (int)g, (int)d, memory) + ROOM_LINE, most = 0;
    char *at = memory ? room_begin(memory + used - ROOM_LINE) : NULL;
    real *part[8] = {0};
    for (int k = 0; k < 8; k++) {
        used += room_for(numbers[k]);
        if (memory) part[k] = room_take(&at, numbers[k]);
    }
    c->seeds = part[0], c->x = part[1], c->m = part[2], c->in = part[3], c->by_in = part[4], c->at = part[5];
    c->by_at = part[6], c->shown = part[7], c->room = (real *)(void *)at;
    const int *place = chain + CHAIN_HEAD + chain[6];
    for (int k = 0; k < chain[0]; k++, place += CHAIN_STAGE)
        if (place[1] >= 0) most = longer(most, hystmpc_chain_rest_room(chain, k));
    return used + room_for(most);
}

long hystmpc_chain_settle_bytes(const int *chain, int rows, int directions) {
    settling c;
    return settle_lay_out(&c, chain, rows, directions, NULL);
}

void hystmpc_chain_settle(const int *chain, const real *constants, const real *kept, int core, int rows, const real *u,
                          const real *y, const real *parameters, int directions, const real *seeds, real *x, real *m,
                          char *memory) {
    settling c = {.chain = chain, .constants = constants, .parameters = parameters, .u = u, .y = y, .core = core};
    settle_lay_out(&c, chain, rows, directions, memory);
    const int g = c.r.abreast, d = directions + 1;
    for (int p = 0; p < chain[2]; p++)
        for (int q = 0; q < d; q++) c.seeds[p * d + q] = q < directions ? seeds[p * directions + q] : R(0.0);
    for (int k = 0; k < g * d; k++) c.by_at[k] = k % d == directions ? R(1.0) : R(0.0), c.by_in[k] = R(0.0);
    for (int n = 0; n < g; n++) c.in[n] = c.shown[n] = R(0.0);
    for (int i = 0; i < c.r.states * g * d; i++) c.m[i] = R(0.0);
    for (int i = 0; i < c.r.states * g; i++) c.x[i] = R(0.0);
    hystmpc_chain_bind(&c.r, kept, 1, 0, 1, 1, PHASE_BY_PARAMETERS);
    for (int n0 = 0; n0 < rows; n0 += g) {
        c.n0 = n0, c.count = smaller(g, rows - n0);
        for (int n = 0; n < g; n++) c.at[n] = y[n0 + smaller(n, c.count - 1)];
        settle_rows(&c);
        store_rows(&c, rows, x, m);
    }
}

#undef SETTLE_WITHIN
