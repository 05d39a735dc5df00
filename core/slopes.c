/* Derivatives of free runs by forward sensitivity, in all directions that the caller asks for.
 *
 * All slopes of a block are computed first, for all its samples side by side. What is left for each direction is linear:
 * a product and a sum a slope, and a loop over the samples for the states alone. A direction that does not reach a state
 * costs nothing there. */
#include "blocks.h"

#include <stddef.h>
#include <string.h>

/* to += value factor, or to = value factor where it is the first term. */
static void add_product(real *restrict to, const real *restrict value, const real *restrict factor, int first, int lanes,
                        int adds) {
    if (adds)
        for (int l = first; l < lanes; l++) to[l] += value[l] * factor[l];
    else
        for (int l = first; l < lanes; l++) to[l] = value[l] * factor[l];
}

static void add_multiple(real *restrict to, const real *restrict value, real factor, int first, int lanes, int adds) {
    if (adds)
        for (int l = first; l < lanes; l++) to[l] += value[l] * factor;
    else
        for (int l = first; l < lanes; l++) to[l] = value[l] * factor;
}

/* One direction of a stage in a block. */
typedef struct {
    const chain_run *r;
    const chain_stage *s;
    const real *seeds; /* of the stage's parameters in this direction, `directions` apart */
    int q, first, lanes;
    int *moves;        /* of the stage's first state in this direction, `directions` apart */
} direction;

enum { BY_STATE, BY_INPUT, BY_PARAMETER };

static real *history_of(const direction *d, int i) { return d->r->history + i * (CHAIN_STRIDE + d->r->abreast); }

/* Whether what a slope multiplies is not zero. */
static int term_acts(const direction *d, const int *slope) {
    const int directions = d->r->directions;
    if (slope[0] == BY_STATE) return d->moves[slope[1] * directions];
    if (slope[0] == BY_INPUT) return d->r->begins[d->s->wires[slope[1]] * directions + d->q] < HYSTMPC_BLOCK;
    return d->seeds[slope[1] * directions] != R(0.0);
}

/* Add slope times what it multiplies; answers 1. */
static int add_term(const direction *d, const int *slope, real *to, int adds) {
    const chain_run *r = d->r;
    const real *value = d->s->row[slope[2]];
    if (slope[0] == BY_STATE) add_product(to, value, history_of(d, slope[1]), d->first, d->lanes, adds);
    else if (slope[0] == BY_INPUT)
        add_product(to, value, r->by + (d->s->wires[slope[1]] * r->directions + d->q) * CHAIN_STRIDE, d->first,
                    d->lanes, adds);
    else add_multiple(to, value, d->seeds[slope[1] * r->directions], d->first, d->lanes, adds);
    return 1;
}

static int is_in(const int *group, int state) {
    for (int k = 1; k <= group[0]; k++)
        if (group[k] == state) return 1;
    return 0;
}

/* A state that only needs itself: G lanes stay in registers from sample to sample, memory would be the slower way. */
static inline void move_lanes(real *restrict h, const real *restrict value, int first, int lanes, const int g) {
    real now[CHAIN_MOST];
    for (int n = 0; n < g; n++) now[n] = h[first + n];
    for (int l = first; l < lanes; l += g)
        for (int n = 0; n < g; n++) h[l + g + n] = now[n] = h[l + g + n] + value[l + n] * now[n];
}

static void move_alone(real *h, const real *value, int first, int lanes, int g) {
    if (g == 8) move_lanes(h, value, first, lanes, 8);
    else if (g == 4) move_lanes(h, value, first, lanes, 4);
    else if (g == 1) move_lanes(h, value, first, lanes, 1);
    else move_lanes(h, value, first, lanes, g);
}

/* Derivatives of a group of states along the block: what comes from outside for all samples, then sample after sample. */
static void move_group(const direction *d, const int *group) {
    const chain_run *r = d->r;
    const hystmpc_code *p = &d->s->p;
    const int g = r->abreast;
    for (int k = 1; k <= group[0]; k++) {
        real *next = history_of(d, group[k]) + g;
        int adds = 0;
        for (int q = p->first[group[k]]; q < p->first[group[k] + 1]; q++) {
            const int *slope = p->slope + 3 * q;
            if (slope[0] == BY_STATE && is_in(group, slope[1])) continue;
            if (term_acts(d, slope)) adds = add_term(d, slope, next, adds);
        }
        if (!adds)
            for (int l = d->first; l < d->lanes; l++) next[l] = R(0.0);
    }
    if (group[0] == 1) {
        const int i = group[1];
        real *h = history_of(d, i);
        for (int q = p->first[i]; q < p->first[i + 1]; q++) {
            const int *slope = p->slope + 3 * q;
            if (slope[0] != BY_STATE || slope[1] != i) continue;
            move_alone(h, d->s->row[slope[2]], d->first, d->lanes, g);
        }
        return;
    }
    for (int t = d->first; t < d->lanes; t += g)
        for (int k = 1; k <= group[0]; k++) {
            real *h = history_of(d, group[k]) + g;
            for (int q = p->first[group[k]]; q < p->first[group[k] + 1]; q++) {
                const int *slope = p->slope + 3 * q;
                if (slope[0] != BY_STATE || !is_in(group, slope[1])) continue;
                const real *value = d->s->row[slope[2]], *other = history_of(d, slope[1]);
                for (int l = t; l < t + g; l++) h[l] += value[l] * other[l];
            }
        }
}

/* Which states of a group have a derivative from now on. */
static int group_acts(const direction *d, const int *group) {
    const hystmpc_code *p = &d->s->p;
    for (int k = 1; k <= group[0]; k++) {
        if (d->moves[group[k] * d->r->directions]) return 1;
        for (int q = p->first[group[k]]; q < p->first[group[k] + 1]; q++)
            if (term_acts(d, p->slope + 3 * q)) return 1;
    }
    return 0;
}

/* First sample of the block from which a direction acts on a stage; HYSTMPC_BLOCK for never. */
static int begin_of(const direction *d) {
    const hystmpc_code *p = &d->s->p;
    const int directions = d->r->directions;
    int first = HYSTMPC_BLOCK;
    for (int i = 0; i < p->states; i++)
        if (d->moves[i * directions]) return 0;
    for (int j = 0; j < p->parameters; j++)
        if (d->seeds[j * directions] != R(0.0)) return 0;
    for (int j = 0; j < p->inputs; j++) first = smaller(first, d->r->begins[d->s->wires[j] * directions + d->q]);
    return first;
}

/* One direction through one stage: from the derivatives of its inputs to those of its outputs and states. */
static void differentiate_stage(direction *d, int samples) {
    const chain_run *r = d->r;
    const hystmpc_code *p = &d->s->p;
    const int g = r->abreast, directions = r->directions, begin = begin_of(d);
    real *moving = r->moving + (d->s->place[2] * directions + d->q) * g;
    for (int o = 0; o < p->outputs; o++) r->begins[d->s->wires[p->inputs + o] * directions + d->q] = begin;
    if (begin >= samples) return;
    d->first = begin * g, d->lanes = samples * g;
    for (int i = 0; i < p->states; i++)
        for (int n = 0; n < g; n++) history_of(d, i)[d->first + n] = moving[i * directions * g + n];
    const int *group = p->group;
    for (int k = 0; k < p->groups; k++, group += 1 + *group) {
        if (!group_acts(d, group)) continue;
        move_group(d, group);
        for (int i = 1; i <= group[0]; i++) d->moves[group[i] * directions] = 1;
    }
    for (int o = 0; o < p->outputs; o++) {
        real *to = r->by + (d->s->wires[p->inputs + o] * directions + d->q) * CHAIN_STRIDE;
        int adds = 0;
        for (int l = 0; l < d->first; l++) to[l] = R(0.0); /* a later stage may begin before its input does */
        for (int q = p->first[p->states + o]; q < p->first[p->states + o + 1]; q++)
            if (term_acts(d, p->slope + 3 * q)) adds = add_term(d, p->slope + 3 * q, to, adds);
        if (!adds)
            for (int l = d->first; l < d->lanes; l++) to[l] = R(0.0);
    }
    for (int i = 0; i < p->states; i++) {
        if (!d->moves[i * directions]) continue;
        for (int n = 0; n < g; n++) moving[i * directions * g + n] = history_of(d, i)[d->lanes + n];
    }
}

void hystmpc_chain_move_stage(const chain_run *r, const chain_stage *s, const real *seeds, int samples) {
    direction d = {.r = r, .s = s};
    for (d.q = 0; d.q < r->directions; d.q++) {
        d.seeds = seeds + s->place[3] * r->directions + d.q;
        d.moves = r->moves + s->place[2] * r->directions + d.q;
        differentiate_stage(&d, samples);
    }
}

/* Runs n0 ... n0 + count - 1, whose samples begin at first[0 ... count - 1] and end at first[1 ... count]. */
typedef struct {
    const int *first;
    int n0, count, runs, samples; /* samples: of all runs */
    const real *u, *du, *seeds, *x, *m;
    real *y, *dy;
} group_of_runs;

/* States and their derivatives before the first sample. */
static void begin_runs(const chain_run *r, const group_of_runs *c) {
    const int g = r->abreast, d = r->directions;
    for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++)
        for (int i = 0; i < s->p.states; i++)
            for (int n = 0; n < g; n++)
                s->state[i * (CHAIN_STRIDE + g) + n] =
                    c->x[(s->place[2] + i) * c->runs + c->n0 + smaller(n, c->count - 1)];
    for (int i = 0; i < r->states; i++)
        for (int q = 0; q < d; q++) {
            r->moves[i * d + q] = 0;
            for (int n = 0; n < g; n++) {
                const real m = c->m[(i * c->runs + c->n0 + smaller(n, c->count - 1)) * d + q];
                r->moving[(i * d + q) * g + n] = m;
                if (m != R(0.0)) r->moves[i * d + q] = 1;
            }
        }
}

/* Inputs of a block and their derivatives; behind its last sample a run stays at its last input. */
static void load_block(const chain_run *r, const group_of_runs *c, int t0, int samples) {
    const int g = r->abreast, d = r->directions;
    for (int j = 0; j < r->inputs; j++)
        for (int n = 0; n < g; n++) {
            const int k = smaller(n, c->count - 1), from = c->first[k], length = c->first[k + 1] - from;
            for (int t = 0; t < samples; t++)
                r->signal[j * CHAIN_STRIDE + t * g + n] =
                    length > 0 ? c->u[j * c->samples + from + smaller(t0 + t, length - 1)] : R(0.0);
        }
    for (int j = 0; j < r->inputs; j++)
        for (int q = 0; q < d; q++) {
            real *by = r->by + (j * d + q) * CHAIN_STRIDE;
            int begin = HYSTMPC_BLOCK;
            if (c->du)
                for (int n = 0; n < g; n++) {
                    const int k = smaller(n, c->count - 1), from = c->first[k], length = c->first[k + 1] - from;
                    for (int t = 0; t < samples; t++) {
                        const real du = t0 + t < length ? c->du[(j * c->samples + from + t0 + t) * d + q] : R(0.0);
                        by[t * g + n] = du;
                        if (du != R(0.0)) begin = smaller(begin, t);
                    }
                }
            r->begins[j * d + q] = begin;
        }
}

/* Outputs of a block and their derivatives. */
static void store_block(const chain_run *r, const group_of_runs *c, int t0, int samples) {
    const int g = r->abreast, d = r->directions;
    for (int n = 0; n < c->count; n++) {
        const int from = c->first[n] + t0, now = smaller(samples, c->first[n + 1] - from);
        for (int o = 0; o < r->outputs; o++) {
            const int shown = r->shown[o];
            for (int t = 0; t < now; t++) c->y[o * c->samples + from + t] = r->signal[shown * CHAIN_STRIDE + t * g + n];
            for (int q = 0; q < d; q++) {
                const real *by = r->by + (shown * d + q) * CHAIN_STRIDE + n;
                real *to = c->dy + (o * c->samples + from) * d + q;
                const int begin = smaller(r->begins[shown * d + q], now > 0 ? now : 0);
                for (int t = 0; t < begin; t++) to[t * d] = R(0.0);
                for (int t = begin; t < now; t++) to[t * d] = by[t * g];
            }
        }
    }
}

static void differentiate_runs(const chain_run *r, const group_of_runs *c) {
    const int g = r->abreast, block = HYSTMPC_BLOCK / g;
    int longest = 0;
    begin_runs(r, c);
    for (int n = 0; n < c->count; n++)
        if (c->first[n + 1] - c->first[n] > longest) longest = c->first[n + 1] - c->first[n];
    for (int t0 = 0; t0 < longest; t0 += block) {
        const int samples = smaller(block, longest - t0);
        load_block(r, c, t0, samples);
        for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++) {
            hystmpc_chain_run_stage(s, g, samples, PHASE_BY_PARAMETERS);
            hystmpc_chain_move_stage(r, s, c->seeds, samples);
        }
        store_block(r, c, t0, samples);
        for (const chain_stage *s = r->stage; s < r->stage + r->stages; s++) hystmpc_chain_go_on(s, g, samples);
    }
}

/* One run in which every command is a direction: sample after sample, the directions that have begun side by side, those
 * of one sample together. Each number is the sum of the same terms in the same order as above; what does not depend on the
 * sample is listed once. */
typedef struct {
    const real *slope, *factor; /* (block), (stride); a first factor that is null: the sum begins with zero */
    real *to;                   /* (stride): in the last term of a sum, else null */
} command_term;

typedef struct {
    const chain_run *r;
    int stride, terms;
    real *now, *next, *signal; /* by commands: states (S, stride), one sample later (S, stride), signals (signals, stride) */
    command_term *term;
    int *acts; /* (S): whether a command reaches a state */
} by_commands;

enum { COMMANDS_ABREAST = 8 };

static int commands_abreast(int count) { return (count + COMMANDS_ABREAST - 1) / COMMANDS_ABREAST * COMMANDS_ABREAST; }

/* Terms that may be listed, however often a state stands in a group; the sum of a state may begin with zero. */
static size_t terms_of(const int *chain) {
    const int *place = chain + CHAIN_HEAD + chain[6];
    size_t count = 0;
    for (int k = 0; k < chain[0]; k++, place += CHAIN_STAGE) {
        hystmpc_code p;
        hystmpc_code_read(chain + place[0], &p);
        const int *group = p.group;
        for (int n = 0; n < p.groups; n++, group += 1 + *group)
            for (int i = 1; i <= *group; i++) count += 1 + (size_t)(p.first[group[i] + 1] - p.first[group[i]]);
        count += (size_t)(p.first[p.states + p.outputs] - p.first[p.states]);
    }
    return count;
}

/* Bytes of memory, all of it zero at first; null for memory: the bytes alone. */
static long lay_out_commands(by_commands *b, const int *chain, int samples, char *memory) {
    const int stride = commands_abreast((chain[5] - chain[7]) * samples), states = chain[1], signals = chain[4];
    const long numbers = (long)stride * (2 * states + signals);
    const size_t terms = terms_of(chain);
    const size_t bytes = (size_t)numbers * sizeof(real) + terms * sizeof(command_term) +
                         (size_t)states * sizeof(int);
    if (!memory) return (long)bytes;
    memset(memory, 0, bytes);
    b->stride = stride, b->terms = 0;
    b->term = (command_term *)(void *)memory;
    b->now = (real *)(void *)(b->term + terms);
    b->next = b->now + states * stride, b->signal = b->next + states * stride;
    b->acts = (int *)(void *)(b->now + numbers);
    return (long)bytes;
}

/* What a slope multiplies; null where that is zero. */
static const real *factor_of(const by_commands *b, const chain_stage *s, const int *slope) {
    if (slope[0] == BY_INPUT) return b->signal + s->wires[slope[1]] * b->stride;
    const int state = s->place[2] + slope[1];
    return slope[0] == BY_STATE && b->acts[state] ? b->now + state * b->stride : NULL;
}

/* Terms of a state or an output, those by states of a state's own group last. */
static void list_terms(by_commands *b, const chain_stage *s, int value, const int *group, real *to) {
    const int begin = b->terms;
    for (int within = 0; within < 2; within++) {
        for (int q = s->p.first[value]; q < s->p.first[value + 1]; q++) {
            const int *slope = s->p.slope + 3 * q;
            const real *factor = factor_of(b, s, slope);
            if (!factor || within != (group && slope[0] == BY_STATE && is_in(group, slope[1]))) continue;
            if (within && b->terms == begin) b->term[b->terms++] = (command_term){NULL, NULL, NULL};
            b->term[b->terms++] = (command_term){s->row[slope[2]], factor, NULL};
        }
    }
    if (b->terms > begin) b->term[b->terms - 1].to = to;
}

static void list_stage(by_commands *b, const chain_stage *s) {
    const hystmpc_code *p = &s->p;
    const int *group = p->group, begin = s->place[2];
    for (int k = 0; k < p->groups; k++, group += 1 + *group) {
        int acts = 0;
        for (int i = 1; i <= group[0]; i++)
            for (int q = p->first[group[i]]; q < p->first[group[i] + 1]; q++)
                acts |= factor_of(b, s, p->slope + 3 * q) != NULL;
        for (int i = 1; i <= group[0]; i++) b->acts[begin + group[i]] = acts;
        for (int i = 1; acts && i <= group[0]; i++)
            list_terms(b, s, group[i], group, b->next + (begin + group[i]) * b->stride);
    }
    for (int o = 0; o < p->outputs; o++)
        list_terms(b, s, p->states + o, NULL, b->signal + s->wires[p->inputs + o] * b->stride);
}

/* One sum by so many commands, some of them at a time in registers; answers its last term. */
static const command_term *sum_terms(const command_term *first, int t, int lanes) {
    const command_term *term = first;
    for (int l = 0; l < lanes; l += COMMANDS_ABREAST) {
        real sum[COMMANDS_ABREAST];
        term = first;
        for (int i = 0; i < COMMANDS_ABREAST; i++) sum[i] = term->factor ? term->slope[t] * term->factor[l + i] : R(0.0);
        while (!term->to) {
            const real slope = (++term)->slope[t], *factor = term->factor + l;
            for (int i = 0; i < COMMANDS_ABREAST; i++) sum[i] += slope * factor[i];
        }
        for (int i = 0; i < COMMANDS_ABREAST; i++) term->to[l + i] = sum[i];
    }
    return term;
}

/* All signals in sample t of a block by the first `count` commands, of which the last `inputs` act for the first time. */
static void linearise_sample(const by_commands *b, int t, int count, int inputs) {
    const int states = b->r->states, stride = b->stride, lanes = commands_abreast(count), begun = count - inputs;
    for (int j = 0; j < inputs; j++) {
        b->signal[j * stride + begun + j] = R(1.0);
        if (begun) b->signal[j * stride + begun - inputs + j] = R(0.0);
        for (int i = 0; i < states; i++) b->now[i * stride + begun + j] = R(0.0);
    }
    for (const command_term *term = b->term; term < b->term + b->terms; term++) term = sum_terms(term, t, lanes);
    for (int i = 0; i < states; i++)
        for (int l = 0; l < lanes; l++) b->now[i * stride + l] = b->next[i * stride + l];
}

/* Angles of one sample, and their derivatives by the first `count` commands; rows of dy (ny H, nu H). */
static void store_sample(const by_commands *b, int t, int sample, int samples, int inputs, real *y, real *dy) {
    const chain_run *r = b->r;
    const int directions = inputs * samples;
    for (int o = 0; o < r->outputs; o++) {
        const int row = o * samples + sample;
        const real *by = b->signal + r->shown[o] * b->stride;
        real *to = dy + (long)row * directions;
        y[row] = r->signal[r->shown[o] * CHAIN_STRIDE + t];
        for (int j = 0; j < inputs; j++, to += samples) {
            for (int q = 0; q <= sample; q++) to[q] = by[q * inputs + j];
            for (int q = sample + 1; q < samples; q++) to[q] = R(0.0);
        }
    }
}

void hystmpc_chain_linearise(const int *chain, const real *kept, const real *x, const real *plan, const real *known,
                             int samples, real *y, real *dy, char *memory) {
    const int inputs = chain[5] - chain[7];
    chain_run r;
    by_commands b = {.r = &r};
    lay_out_commands(&b, chain, samples, memory + hystmpc_chain_lay_out(&r, chain, 1, 0, memory));
    if (!chain_knows(chain, known, samples)) {
        for (int i = 0; i < chain[6] * samples; i++) y[i] = (real)NAN;
        for (int i = 0; i < chain[6] * samples * inputs * samples; i++) dy[i] = (real)NAN;
        return;
    }
    hystmpc_chain_bind(&r, kept, 1, 0, 1, samples, PHASE_SLOPES);
    for (const chain_stage *s = r.stage; s < r.stage + r.stages; s++) {
        list_stage(&b, s);
        for (int i = 0; i < s->p.states; i++) s->state[i * (CHAIN_STRIDE + 1)] = x[s->place[2] + i];
    }
    for (int t0 = 0; t0 < samples; t0 += HYSTMPC_BLOCK) {
        const int now = smaller(HYSTMPC_BLOCK, samples - t0);
        for (int j = 0; j < chain[5]; j++) {
            const real *from = j < inputs ? plan + j * samples : known + (j - inputs) * samples;
            for (int t = 0; t < now; t++) r.signal[j * CHAIN_STRIDE + t] = from[t0 + t];
        }
        for (const chain_stage *s = r.stage; s < r.stage + r.stages; s++) hystmpc_chain_run_stage(s, 1, now, PHASE_SLOPES);
        for (int t = 0; t < now; t++) {
            linearise_sample(&b, t, (t0 + t + 1) * inputs, inputs);
            store_sample(&b, t, t0 + t, samples, inputs, y, dy);
        }
        for (const chain_stage *s = r.stage; s < r.stage + r.stages; s++) hystmpc_chain_go_on(s, 1, now);
    }
}

long hystmpc_chain_linearise_bytes(const int *chain, int samples) {
    chain_run r;
    return hystmpc_chain_lay_out(&r, chain, 1, 0, NULL) + lay_out_commands(NULL, chain, samples, NULL) + 64;
}

void hystmpc_chain_differentiate(const int *chain, const real *kept, int rows, const int *first, const real *u,
                                 const real *du, int directions, const real *seeds, const real *x, const real *m,
                                 real *y, real *dy, char *memory) {
    chain_run r;
    hystmpc_chain_lay_out(&r, chain, hystmpc_chain_abreast(rows), directions, memory);
    int longest = 0;
    for (int n = 0; n < rows; n++)
        if (first[n + 1] - first[n] > longest) longest = first[n + 1] - first[n];
    hystmpc_chain_bind(&r, kept, 1, 0, 1, longest, PHASE_BY_PARAMETERS);
    for (int n0 = 0; n0 < rows; n0 += r.abreast) {
        const group_of_runs c = {.first = first + n0, .n0 = n0, .count = smaller(r.abreast, rows - n0), .runs = rows,
                                 .samples = first[rows], .u = u, .du = du, .seeds = seeds, .x = x, .m = m, .y = y, .dy = dy};
        differentiate_runs(&r, &c);
    }
}
