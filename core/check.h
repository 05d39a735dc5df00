/* Whether a chain may be run: a block from a file or another process must not lead the interpreter out of its memory. */
#ifndef HYSTMPC_CHECK_H
#define HYSTMPC_CHECK_H

#include "chain.h"

/* What is wrong with a chain. Behind HYSTMPC_OF_REST the fault is that of a table at rest, and every stage before the
 * faulty one adds HYSTMPC_OF_STAGE. */
enum {
    HYSTMPC_SOUND = 0,
    HYSTMPC_FAULT_PLACE = 1,     /* a part lies outside the block */
    HYSTMPC_FAULT_COUNT = 2,     /* a count is negative, zero where there has to be one, or too great */
    HYSTMPC_FAULT_SUM = 3,       /* states, parameters, kept values or constants are not those of all stages in turn */
    HYSTMPC_FAULT_WIRE = 4,      /* a signal is read before it is there, or written twice, or not there at all */
    HYSTMPC_FAULT_ROOM = 5,      /* rows or registers are fewer than what they hold, or more than can be used */
    HYSTMPC_FAULT_OPERATION = 6, /* there is no such operation */
    HYSTMPC_FAULT_REGISTER = 7,  /* a row or register is not there */
    HYSTMPC_FAULT_RESULT = 8,    /* a result lies where an argument does, or in what is only read */
    HYSTMPC_FAULT_SLOPE = 9,     /* a slope is by what is not there, or their ranges do not ascend */
    HYSTMPC_FAULT_GROUP = 10,    /* a group of states has a state that is not there, or states are in none */
    HYSTMPC_FAULT_REST = 11,     /* the table at rest is not of this operator */
    HYSTMPC_OF_REST = 32,
    HYSTMPC_OF_STAGE = 64
};

/* 0, or what is wrong with a block of `size` whole numbers that uses `constants` numbers.
 *
 * Behind 0, no function of chain.h and follow.h reads or writes outside the memory that it is given, for any states,
 * parameters and commands, nan and inf among them. What depends on the call is the caller's: sizes of the other arrays,
 * and that a size times rows, samples or directions is an `int`; one input and one output where chain.h says so; a stage
 * that has a table at rest. */
HYSTMPC_API int hystmpc_chain_check(const int *chain, int size, int constants);

#endif
