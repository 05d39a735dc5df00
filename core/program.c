/* The interpreter of programs. */
#include "program.h"

enum { CODE_ABREAST = 4 };

int hystmpc_code_read(const int *table, hystmpc_code *p) {
    const int *at = table + 1;
    int *const sizes[] = {&p->states, &p->inputs, &p->parameters, &p->outputs,   &p->kept,
                          &p->rows,   &p->slopes, &p->groups,     &p->registers, &p->single};
    for (unsigned k = 0; k < sizeof sizes / sizeof *sizes; k++) *sizes[k] = *at++;
    for (int k = 0; k < PHASES; k++) p->length[k] = *at++;
    p->keeps = at;
    at += p->kept;
    for (int k = 0; k < PHASES; k++) {
        p->code[k] = at;
        at += CODE_WORDS * p->length[k];
    }
    p->slope = at;
    at += 3 * p->slopes;
    p->first = at;
    at += p->states + p->outputs + 1;
    p->group = at;
    for (int k = 0; k < p->groups; k++) at += 1 + *at;
    p->results = at;
    p->straight = hystmpc_straight_for(table);
    return (int)(at - table) + 1 + p->outputs + p->states;
}

/* A result never lies where an argument does, as the compiler may assume. */
#define CODE_ALL_LANES(name, value)                             \
    case OP_##name:                                             \
        for (int l = 0; l < lanes; l += CODE_ABREAST)           \
            for (int i = l; i < l + CODE_ABREAST; i++) {        \
                const real a = from_a[i], b = from_b[i], c = from_c[i]; \
                (void)a, (void)b, (void)c;                      \
                to[i] = (value);                                \
            }                                                   \
        break;

void hystmpc_code_lanes(const int *code, int length, real *const *row, int at, int lanes) {
    for (const int *s = code, *end = code + CODE_WORDS * length; s < end; s += CODE_WORDS) {
        real *restrict to = row[s[1]] + at;
        const real *restrict from_a = row[s[2]] + at, *restrict from_b = row[s[3]] + at, *restrict from_c = row[s[4]] + at;
        switch (s[0]) { CODE_OPERATIONS(CODE_ALL_LANES) }
    }
}

/* What an operation does not need is not read: that is most of the time of a single number. */
#define CODE_ONE_SAMPLE(name, value)                                     \
    case OP_##name: {                                                    \
        const real a = row[s[2]][t], b = row[s[3]][t], c = row[s[4]][t]; \
        (void)a, (void)b, (void)c;                                       \
        row[s[1]][t] = (value);                                          \
        break;                                                           \
    }

void hystmpc_code_samples(const int *code, int length, real *const *row, int first, int samples) {
    const int *end = code + CODE_WORDS * length;
    for (int t = first; t < first + samples; t++)
        for (const int *s = code; s < end; s += CODE_WORDS)
            switch (s[0]) { CODE_OPERATIONS(CODE_ONE_SAMPLE) }
}

#define CODE_ONE_NUMBER(name, value)                                              \
    case OP_##name: {                                                             \
        const real a = registers[s[2]], b = registers[s[3]], c = registers[s[4]]; \
        (void)a, (void)b, (void)c;                                                \
        registers[s[1]] = (value);                                                \
        break;                                                                    \
    }

void hystmpc_code_single(const int *code, int length, real *registers) {
    for (const int *s = code, *end = code + CODE_WORDS * length; s < end; s += CODE_WORDS)
        switch (s[0]) { CODE_OPERATIONS(CODE_ONE_NUMBER) }
}

void hystmpc_code_moving(const hystmpc_code *p, real *registers) {
    if (p->straight) p->straight->moving(registers);
    else hystmpc_code_single(p->code[PHASE_MOVING], p->length[PHASE_MOVING], registers);
}

void hystmpc_code_prepare(const hystmpc_code *p, const real *constants, int count, const real *parameters, int stride,
                          real dt, real *kept, int kept_stride, real *room) {
    for (int j = 0; j < p->parameters; j++) room[j] = parameters[j * stride];
    room[p->parameters] = dt;
    for (int k = 0; k < count; k++) room[p->parameters + 1 + k] = constants[k];
    hystmpc_code_single(p->code[PHASE_ONCE], p->length[PHASE_ONCE], room);
    for (int k = 0; k < p->kept; k++) kept[k * kept_stride] = room[p->keeps[k]];
}

#undef CODE_ALL_LANES
#undef CODE_ONE_SAMPLE
#undef CODE_ONE_NUMBER
