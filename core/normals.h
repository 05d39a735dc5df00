/* Standard normal numbers of a seed and a step: those of numpy.random.Generator(Philox(key=seed, counter=[0, 0, step, 0])),
 * to the last bit but for `log1p` and `exp` of another C library. */
#ifndef HYSTMPC_NORMALS_H
#define HYSTMPC_NORMALS_H

#include "hystmpc_core.h"
#include "linear.h"

#include <stdint.h>

/* Where a sequence of random numbers is. */
typedef struct {
    uint64_t counter[4], key[2];
    uint64_t block[4]; /* of random bits */
    int used;          /* words of the block */
} hystmpc_normals;

/* The beginning of the sequence of a seed (2 words, the lower one first) and a step. */
HYSTMPC_LOCAL void hystmpc_normals_init(hystmpc_normals *g, const uint64_t *seed, int64_t step);

/* The next numbers; drawn in double precision, rounded to single where the engine is. */
HYSTMPC_LOCAL void hystmpc_normals_draw(hystmpc_normals *g, int count, real *numbers);

/* The first numbers of a sequence; words (3): seed and step, of 64 bits. */
HYSTMPC_API void hystmpc_normal_numbers(const void *words, int count, real *numbers);

#endif
