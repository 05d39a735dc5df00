/* The interpreter of programs. */
#include "program.h"

/* As `BINARY`, `UNARY` and `select` of models/program.py. */
enum operation {
    OP_ADD, OP_SUB, OP_MUL, OP_DIV, OP_LT, OP_LE, OP_EQ, OP_NE, OP_AND, OP_OR, OP_IF_ELSE_ZERO, OP_FMIN, OP_FMAX, OP_POW,
    OP_NEG, OP_FABS, OP_SIGN, OP_SQRT, OP_SQ, OP_TWICE, OP_INV, OP_NOT, OP_EXP, OP_LOG, OP_TANH, OP_SIN, OP_COS, OP_FLOOR,
    OP_ASSIGN, OP_SELECT
};

typedef char code_kinds_are_all[OP_SELECT + 1 == CODE_KINDS ? 1 : -1];

enum { CODE_ABREAST = 4 };

/* The value of one instruction by its arguments a, b, c. Conditions are numbers, 1 or 0, as in CasADi. */
#define CODE_OPERATIONS(DO)                                  \
    case OP_ADD: DO(a + b)                                 \
    case OP_SUB: DO(a - b)                                 \
    case OP_MUL: case OP_AND: DO(a * b)                       \
    case OP_DIV: DO(a / b)                                 \
    case OP_LT: DO(a < b ? R(1.0) : R(0.0))                \
    case OP_LE: DO(a <= b ? R(1.0) : R(0.0))               \
    case OP_EQ: DO(a == b ? R(1.0) : R(0.0))               \
    case OP_NE: DO(a != b ? R(1.0) : R(0.0))               \
    case OP_OR: DO(a + b > R(0.0) ? R(1.0) : R(0.0))       \
    case OP_IF_ELSE_ZERO: DO(a != R(0.0) ? b : R(0.0))     \
    case OP_FMIN: DO(a <= b ? a : b)                       \
    case OP_FMAX: DO(a >= b ? a : b)                       \
    case OP_POW: DO(MATH(pow)(a, b))                       \
    case OP_NEG: DO(-a)                                    \
    case OP_FABS: DO(MATH(fabs)(a))                        \
    case OP_SIGN: DO((a > R(0.0) ? R(1.0) : R(0.0)) - (a < R(0.0) ? R(1.0) : R(0.0))) \
    case OP_SQRT: DO(MATH(sqrt)(a))                        \
    case OP_SQ: DO(a * a)                                  \
    case OP_TWICE: DO(a + a)                               \
    case OP_INV: DO(R(1.0) / a)                            \
    case OP_NOT: DO(R(1.0) - a)                            \
    case OP_EXP: DO(MATH(exp)(a))                          \
    case OP_LOG: DO(MATH(log)(a))                          \
    case OP_TANH: DO(MATH(tanh)(a))                        \
    case OP_SIN: DO(MATH(sin)(a))                          \
    case OP_COS: DO(MATH(cos)(a))                          \
    case OP_FLOOR: DO(MATH(floor)(a))                      \
    case OP_ASSIGN: DO(a)                                  \
    case OP_SELECT: DO(a != R(0.0) ? b : c)

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
    return (int)(at - table) + 1 + p->outputs + p->states;
}

/* A result never lies where an argument does, as the compiler may assume. */
#define CODE_ALL_LANES(value)                                   \
    for (int l = 0; l < lanes; l += CODE_ABREAST)               \
        for (int i = l; i < l + CODE_ABREAST; i++) {            \
            const real a = from_a[i], b = from_b[i], c = from_c[i]; \
            (void)a, (void)b, (void)c;                     \
            to[i] = (value);                               \
        }                                                  \
    break;

void hystmpc_code_lanes(const int *code, int length, real *const *row, int at, int lanes) {
    for (const int *s = code, *end = code + CODE_WORDS * length; s < end; s += CODE_WORDS) {
        real *restrict to = row[s[1]] + at;
        const real *restrict from_a = row[s[2]] + at, *restrict from_b = row[s[3]] + at, *restrict from_c = row[s[4]] + at;
        switch (s[0]) { CODE_OPERATIONS(CODE_ALL_LANES) }
    }
}

/* What an operation does not need is not read: that is most of the time of a single number. */
#define CODE_ONE_SAMPLE(value) {                                               \
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

#define CODE_ONE_NUMBER(value) {                                                     \
        const real a = registers[s[2]], b = registers[s[3]], c = registers[s[4]]; \
        (void)a, (void)b, (void)c;                                                \
        registers[s[1]] = (value);                                                \
        break;                                                                    \
    }

void hystmpc_code_single(const int *code, int length, real *registers) {
    for (const int *s = code, *end = code + CODE_WORDS * length; s < end; s += CODE_WORDS)
        switch (s[0]) { CODE_OPERATIONS(CODE_ONE_NUMBER) }
}

void hystmpc_code_prepare(const hystmpc_code *p, const real *constants, int count, const real *parameters, int stride,
                          real dt, real *kept, int kept_stride, real *room) {
    for (int j = 0; j < p->parameters; j++) room[j] = parameters[j * stride];
    room[p->parameters] = dt;
    for (int k = 0; k < count; k++) room[p->parameters + 1 + k] = constants[k];
    hystmpc_code_single(p->code[PHASE_ONCE], p->length[PHASE_ONCE], room);
    for (int k = 0; k < p->kept; k++) kept[k * kept_stride] = room[p->keeps[k]];
}

#undef CODE_OPERATIONS
#undef CODE_ALL_LANES
#undef CODE_ONE_SAMPLE
#undef CODE_ONE_NUMBER
