/* The interpreter of programs. */
#include "program.h"

/* As `BINARY`, `UNARY` and `select` of models/program.py. */
enum operation {
    ADD, SUB, MUL, DIV, LT, LE, EQ, NE, AND, OR, IF_ELSE_ZERO, FMIN, FMAX, POW,
    NEG, FABS, SIGN, SQRT, SQ, TWICE, INV, NOT, EXP, LOG, TANH, SIN, COS, FLOOR, ASSIGN, SELECT
};

enum { WORDS = 5, ABREAST = 4 };

/* The value of one instruction by its arguments a, b, c. Conditions are numbers, 1 or 0, as in CasADi. */
#define OPERATIONS(DO)                                  \
    case ADD: DO(a + b)                                 \
    case SUB: DO(a - b)                                 \
    case MUL: case AND: DO(a * b)                       \
    case DIV: DO(a / b)                                 \
    case LT: DO(a < b ? R(1.0) : R(0.0))                \
    case LE: DO(a <= b ? R(1.0) : R(0.0))               \
    case EQ: DO(a == b ? R(1.0) : R(0.0))               \
    case NE: DO(a != b ? R(1.0) : R(0.0))               \
    case OR: DO(a + b > R(0.0) ? R(1.0) : R(0.0))       \
    case IF_ELSE_ZERO: DO(a != R(0.0) ? b : R(0.0))     \
    case FMIN: DO(a <= b ? a : b)                       \
    case FMAX: DO(a >= b ? a : b)                       \
    case POW: DO(MATH(pow)(a, b))                       \
    case NEG: DO(-a)                                    \
    case FABS: DO(MATH(fabs)(a))                        \
    case SIGN: DO((a > R(0.0) ? R(1.0) : R(0.0)) - (a < R(0.0) ? R(1.0) : R(0.0))) \
    case SQRT: DO(MATH(sqrt)(a))                        \
    case SQ: DO(a * a)                                  \
    case TWICE: DO(a + a)                               \
    case INV: DO(R(1.0) / a)                            \
    case NOT: DO(R(1.0) - a)                            \
    case EXP: DO(MATH(exp)(a))                          \
    case LOG: DO(MATH(log)(a))                          \
    case TANH: DO(MATH(tanh)(a))                        \
    case SIN: DO(MATH(sin)(a))                          \
    case COS: DO(MATH(cos)(a))                          \
    case FLOOR: DO(MATH(floor)(a))                      \
    case ASSIGN: DO(a)                                  \
    case SELECT: DO(a != R(0.0) ? b : c)

int program_read(const int *table, hystmpc_program *p) {
    const int *at = table + 1;
    int *const sizes[] = {&p->states, &p->inputs, &p->parameters, &p->outputs,   &p->kept,
                          &p->rows,   &p->slopes, &p->groups,     &p->registers, &p->single};
    for (unsigned k = 0; k < sizeof sizes / sizeof *sizes; k++) *sizes[k] = *at++;
    for (int k = 0; k < PHASES; k++) p->length[k] = *at++;
    p->keeps = at;
    at += p->kept;
    for (int k = 0; k < PHASES; k++) {
        p->code[k] = at;
        at += WORDS * p->length[k];
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
#define ALL_LANES(value)                                   \
    for (int l = 0; l < lanes; l += ABREAST)               \
        for (int i = l; i < l + ABREAST; i++) {            \
            const real a = from_a[i], b = from_b[i], c = from_c[i]; \
            (void)a, (void)b, (void)c;                     \
            to[i] = (value);                               \
        }                                                  \
    break;

void program_lanes(const int *code, int length, real *const *row, int at, int lanes) {
    for (const int *s = code, *end = code + WORDS * length; s < end; s += WORDS) {
        real *restrict to = row[s[1]] + at;
        const real *restrict from_a = row[s[2]] + at, *restrict from_b = row[s[3]] + at, *restrict from_c = row[s[4]] + at;
        switch (s[0]) { OPERATIONS(ALL_LANES) }
    }
}

#define ONE_SAMPLE(value) { row[s[1]][t] = (value); break; }

void program_samples(const int *code, int length, real *const *row, int first, int samples) {
    const int *end = code + WORDS * length;
    for (int t = first; t < first + samples; t++)
        for (const int *s = code; s < end; s += WORDS) {
            const real a = row[s[2]][t], b = row[s[3]][t], c = row[s[4]][t];
            switch (s[0]) { OPERATIONS(ONE_SAMPLE) }
        }
}

#define ONE_NUMBER(value) { registers[s[1]] = (value); break; }

void program_single(const int *code, int length, real *registers) {
    for (const int *s = code, *end = code + WORDS * length; s < end; s += WORDS) {
        const real a = registers[s[2]], b = registers[s[3]], c = registers[s[4]];
        switch (s[0]) { OPERATIONS(ONE_NUMBER) }
    }
}

void program_prepare(const hystmpc_program *p, const real *constants, int count, const real *parameters, int stride,
                     real dt, real *kept, int kept_stride, real *room) {
    for (int j = 0; j < p->parameters; j++) room[j] = parameters[j * stride];
    room[p->parameters] = dt;
    for (int k = 0; k < count; k++) room[p->parameters + 1 + k] = constants[k];
    program_single(p->code[ONCE], p->length[ONCE], room);
    for (int k = 0; k < p->kept; k++) kept[k * kept_stride] = room[p->keeps[k]];
}
