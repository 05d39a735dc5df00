/* Operations of programs, once: for the interpreter, and for programs that are written in C. */
#ifndef HYSTMPC_OPERATIONS_H
#define HYSTMPC_OPERATIONS_H

#include "real.h"

/* As `BINARY`, `UNARY` and `select` of models/program.py: name, and value by the arguments a, b, c. Conditions are
 * numbers, 1 or 0, as in CasADi. */
#define CODE_OPERATIONS(DO)                                \
    DO(add, a + b)                                         \
    DO(sub, a - b)                                         \
    DO(mul, a * b)                                         \
    DO(div, a / b)                                         \
    DO(lt, a < b ? R(1.0) : R(0.0))                        \
    DO(le, a <= b ? R(1.0) : R(0.0))                       \
    DO(eq, a == b ? R(1.0) : R(0.0))                       \
    DO(ne, a != b ? R(1.0) : R(0.0))                       \
    DO(and, a * b)                                         \
    DO(or, a + b > R(0.0) ? R(1.0) : R(0.0))               \
    DO(if_else_zero, a != R(0.0) ? b : R(0.0))             \
    DO(fmin, a <= b ? a : b)                               \
    DO(fmax, a >= b ? a : b)                               \
    DO(pow, MATH(pow)(a, b))                               \
    DO(neg, -a)                                            \
    DO(fabs, MATH(fabs)(a))                                \
    DO(sign, (a > R(0.0) ? R(1.0) : R(0.0)) - (a < R(0.0) ? R(1.0) : R(0.0))) \
    DO(sqrt, MATH(sqrt)(a))                                \
    DO(sq, a * a)                                          \
    DO(twice, a + a)                                       \
    DO(inv, R(1.0) / a)                                    \
    DO(not, R(1.0) - a)                                    \
    DO(exp, MATH(exp)(a))                                  \
    DO(log, MATH(log)(a))                                  \
    DO(tanh, MATH(tanh)(a))                                \
    DO(sin, MATH(sin)(a))                                  \
    DO(cos, MATH(cos)(a))                                  \
    DO(floor, MATH(floor)(a))                              \
    DO(assign, a)                                          \
    DO(select, a != R(0.0) ? b : c)

#define CODE_NUMBER(name, value) OP_##name,
enum { CODE_OPERATIONS(CODE_NUMBER) CODE_KINDS };
#undef CODE_NUMBER

#define CODE_FUNCTION(name, value)                                    \
    static inline real hystmpc_op_##name(real a, real b, real c) {    \
        (void)a, (void)b, (void)c;                                    \
        return value;                                                 \
    }
CODE_OPERATIONS(CODE_FUNCTION)
#undef CODE_FUNCTION

#endif
