/* Free runs of chains, block by block. */
#include "blocks.h"

#include <stddef.h>
#include <string.h>

/* The next bytes of the memory of a call; without memory they are counted alone. */
static void *chain_take(char *memory, size_t *used, size_t bytes) {
    void *given = memory ? memory + *used : NULL;
    *used += (bytes + 63) / 64 * 64;
    return given;
}

long hystmpc_chain_lay_out(chain_run *r, const int *chain, int abreast, int directions, char *memory) {
    char *const begin = memory ? memory + (64 - (size_t)memory % 64) % 64 : NULL;
    size_t used = 0;
    const int *place = chain + CHAIN_HEAD + chain[6];
    const size_t d = (size_t)directions, g = (size_t)abreast;
    int most = 0;
    r->stages = chain[0], r->states = chain[1], r->signals = chain[4], r->inputs = chain[5], r->outputs = chain[6];
    r->commands = chain[5] - chain[7], r->shown = chain + CHAIN_HEAD, r->abreast = abreast, r->directions = directions;
    r->stage = chain_take(begin, &used, (size_t)r->stages * sizeof(chain_stage));
    for (int k = 0; k < r->stages; k++, place += CHAIN_STAGE) {
        chain_stage one, *s = memory ? r->stage + k : &one;
        hystmpc_code_read(chain + place[0], &s->p);
        s->place = place, s->wires = chain + place[8];
        s->row = chain_take(begin, &used, (size_t)s->p.rows * sizeof(real *));
        const int with_room = s->p.rows - 2 * s->p.states - s->p.inputs - s->p.outputs;
        s->room = chain_take(begin, &used, (size_t)with_room * CHAIN_STRIDE * sizeof(real));
        s->state = chain_take(begin, &used, (size_t)s->p.states * (CHAIN_STRIDE + g) * sizeof(real));
        if (s->p.states > most) most = s->p.states;
    }
    r->signal = chain_take(begin, &used, (size_t)r->signals * CHAIN_STRIDE * sizeof(real));
    r->by = chain_take(begin, &used, (size_t)r->signals * d * CHAIN_STRIDE * sizeof(real));
    r->moving = chain_take(begin, &used, (size_t)r->states * d * g * sizeof(real));
    r->history = chain_take(begin, &used, (size_t)most * (CHAIN_STRIDE + g) * sizeof(real));
    r->begins = chain_take(begin, &used, (size_t)r->signals * d * sizeof(int));
    r->moves = chain_take(begin, &used, (size_t)r->states * d * sizeof(int));
    return (long)used + 128;
}

int hystmpc_chain_abreast(int rows) {
    int best = 4, idle = HYSTMPC_BLOCK;
    if (rows < 2) return 1;
    for (int g = 4; g <= CHAIN_MOST; g += 4) {
        const int more = (g - rows % g) % g;
        if (more <= idle) best = g, idle = more;
    }
    return best;
}

long hystmpc_chain_bytes(const int *chain, int rows, int directions) {
    chain_run r;
    return hystmpc_chain_lay_out(&r, chain, hystmpc_chain_abreast(rows), directions, NULL);
}

void hystmpc_chain_prepare(const int *chain, const real *constants, const real *parameters, int rows, real dt,
                           real *kept, real *room) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    for (int k = 0; k < chain[0]; k++, place += CHAIN_STAGE) {
        hystmpc_code p;
        hystmpc_code_read(chain + place[0], &p);
        for (int n = 0; n < rows; n++)
            hystmpc_code_prepare(&p, constants + place[5], place[6], parameters + place[3] * rows + n, rows, (real)dt,
                            kept + place[4] * rows + n, rows, room);
    }
}

static int chain_whole_lanes(int lanes) { return (lanes + 3) / 4 * 4; }

void hystmpc_chain_bind(const chain_run *r, const real *kept, int kept_rows, int n0, int count, int samples,
                        int last) {
    const int g = r->abreast, whole = samples < HYSTMPC_BLOCK / g ? chain_whole_lanes(samples * g) : HYSTMPC_BLOCK;
    for (chain_stage *s = r->stage; s < r->stage + r->stages; s++) {
        const hystmpc_code *p = &s->p;
        const int lanes = p->straight && last == PHASE_BEHIND ? g : whole;
        real *room = s->room, **row = s->row;
        for (int k = 0; k < p->kept; k++, room += CHAIN_STRIDE) {
            const real *value = kept + (s->place[4] + k) * kept_rows;
            *row++ = room;
            if (kept_rows > 1)
                for (int l = 0; l < lanes; l++) room[l] = value[n0 + smaller(l % g, count - 1)];
            else
                for (int l = 0; l < lanes; l++) room[l] = value[0];
        }
        for (int next = 0; next < 2; next++)
            for (int i = 0; i < p->states; i++) *row++ = s->state + i * (CHAIN_STRIDE + g) + next * g;
        for (int j = 0; j < p->inputs + p->outputs; j++) *row++ = r->signal + s->wires[j] * CHAIN_STRIDE;
        for (; row < s->row + p->rows; room += CHAIN_STRIDE) *row++ = room;
    }
}

void hystmpc_chain_run_stage(const chain_stage *s, int g, int samples, int last) {
    const hystmpc_code *p = &s->p;
    const int lanes = chain_whole_lanes(samples * g);
    if (p->straight && last == PHASE_BEHIND) {
        p->straight->run(s->row, g, samples);
        return;
    }
    if (p->straight && last == PHASE_SLOPES && g == 1) {
        p->straight->slopes(s->row, samples);
        return;
    }
    hystmpc_code_lanes(p->code[PHASE_AHEAD], p->length[PHASE_AHEAD], s->row, 0, lanes);
    const int *const through = p->code[PHASE_THROUGH], length = p->length[PHASE_THROUGH];
    if (length && g == 1) hystmpc_code_samples(through, length, s->row, 0, samples);
    else if (length)
        for (int t = 0; t < samples; t++) hystmpc_code_lanes(through, length, s->row, t * g, g);
    for (int k = PHASE_BEHIND; k <= last; k++) hystmpc_code_lanes(p->code[k], p->length[k], s->row, 0, lanes);
}

void hystmpc_chain_go_on(const chain_stage *s, int g, int samples) {
    for (int i = 0; i < s->p.states; i++) {
        real *x = s->state + i * (CHAIN_STRIDE + g);
        for (int n = 0; n < g; n++) x[n] = x[samples * g + n];
    }
}

/* Rows n0 ... n0 + count - 1 of hystmpc_chain_simulate. */
static void chain_simulate_rows(const chain_run *r, int n0, int count, int samples, const real *u, const int *us,
                                const real *known, real *x, const int *xs, int moves, real *y, const int *ys) {
    const int g = r->abreast, block = HYSTMPC_BLOCK / g;
    for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++)
        for (int i = 0; i < s->p.states; i++)
            for (int n = 0; n < g; n++)
                s->state[i * (CHAIN_STRIDE + g) + n] =
                    x[(s->place[2] + i) * xs[0] + (n0 + smaller(n, count - 1)) * xs[1]];
    for (int t0 = 0; t0 < samples; t0 += block) {
        const int now = smaller(block, samples - t0);
        for (int j = 0; j < r->inputs; j++) {
            const int own = !known || j < r->commands, by_sample = own ? us[1] : 1, by_row = own ? us[2] : 0;
            const real *const from = own ? u + j * us[0] : known + (j - r->commands) * samples;
            for (int n = 0; n < g; n++) {
                const real *const row = from + t0 * by_sample + (n0 + smaller(n, count - 1)) * by_row;
                real *const to = r->signal + j * CHAIN_STRIDE + n;
                for (int t = 0; t < now; t++) to[t * g] = row[t * by_sample];
            }
        }
        for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++) {
            hystmpc_chain_run_stage(s, g, now, PHASE_BEHIND);
            hystmpc_chain_go_on(s, g, now);
        }
        for (int j = 0; j < r->outputs; j++)
            for (int n = 0; n < count; n++) {
                const real *const from = r->signal + r->shown[j] * CHAIN_STRIDE + n;
                real *const to = y + j * ys[0] + t0 * ys[1] + (n0 + n) * ys[2];
                for (int t = 0; t < now; t++) to[t * ys[1]] = from[t * g];
            }
    }
    if (!moves) return;
    for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++)
        for (int i = 0; i < s->p.states; i++)
            for (int n = 0; n < count; n++)
                x[(s->place[2] + i) * xs[0] + (n0 + n) * xs[1]] = s->state[i * (CHAIN_STRIDE + g) + n];
}

void hystmpc_chain_simulate(const int *chain, const real *kept, int kept_rows, int rows, int samples, const real *u,
                            const int *u_stride, const real *known, real *x, const int *x_stride, int moves, real *y,
                            const int *y_stride, char *memory) {
    chain_run r;
    hystmpc_chain_lay_out(&r, chain, hystmpc_chain_abreast(rows), 0, memory);
    for (int n0 = 0; n0 < rows; n0 += r.abreast) {
        const int count = smaller(r.abreast, rows - n0);
        if (n0 == 0 || kept_rows > 1) hystmpc_chain_bind(&r, kept, kept_rows, n0, count, samples, PHASE_BEHIND);
        chain_simulate_rows(&r, n0, count, samples, u, u_stride, known, x, x_stride, moves, y, y_stride);
    }
}

void hystmpc_chain_roll_out(const int *chain, const real *kept, const real *x, int rows, int samples, const real *plans,
                            const real *known, real *y, char *memory) {
    const int commands = chain[5] - chain[7], by_state[2] = {1, 0};
    const int by_plan[3] = {samples, 1, commands * samples}, by_angle[3] = {samples, 1, chain[6] * samples};
    if (!chain_knows(chain, known, samples)) {
        for (int i = 0; i < rows * chain[6] * samples; i++) y[i] = (real)NAN;
        return;
    }
    hystmpc_chain_simulate(chain, kept, 1, rows, samples, plans, by_plan, known, (real *)x, by_state, 0, y, by_angle,
                           memory);
}
