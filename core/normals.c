/* Random bits by a counter (Salmon et al., SC 2011), normal numbers by a ziggurat (Marsaglia and Tsang, 2000).
 *
 * The order in which bits are used is that of NumPy (numpy/random/src/distributions/distributions.c, BSD-3-Clause). */
#include "normals.h"

#include "ziggurat.h"

/* Of a product of two words the higher one, by halves of 32 bits; the lower one is what C answers. */
static uint64_t normals_high(uint64_t a, uint64_t b) {
    const uint64_t half = 0xffffffffu, a0 = a & half, a1 = a >> 32, b0 = b & half, b1 = b >> 32;
    const uint64_t low = a0 * b0, first = a1 * b0 + (low >> 32), second = a0 * b1 + (first & half);
    return a1 * b1 + (first >> 32) + (second >> 32);
}

/* Philox 4x64-10: the block of the next counter. */
static void normals_next_block(hystmpc_normals *g) {
    static const uint64_t factor0 = 0xd2e7470ee14c6c93u, factor1 = 0xca5a826395121157u; /* of Salmon et al. */
    static const uint64_t golden = 0x9e3779b97f4a7c15u, root = 0xbb67ae8584caa73bu;     /* ratio, of 3 less 1 */
    for (int i = 0; i < 4 && ++g->counter[i] == 0; i++) {}
    uint64_t x0 = g->counter[0], x1 = g->counter[1], x2 = g->counter[2], x3 = g->counter[3];
    uint64_t key0 = g->key[0], key1 = g->key[1];
    for (int round = 0; round < 10; round++, key0 += golden, key1 += root) {
        const uint64_t high0 = normals_high(factor0, x0), low0 = factor0 * x0;
        const uint64_t high1 = normals_high(factor1, x2), low1 = factor1 * x2;
        x0 = high1 ^ x1 ^ key0;
        x1 = low1;
        x2 = high0 ^ x3 ^ key1;
        x3 = low0;
    }
    g->block[0] = x0;
    g->block[1] = x1;
    g->block[2] = x2;
    g->block[3] = x3;
    g->used = 0;
}

static uint64_t normals_bits(hystmpc_normals *g) {
    if (g->used > 3) normals_next_block(g);
    return g->block[g->used++];
}

/* In [0, 1), of 53 bits. */
static double normals_uniform(hystmpc_normals *g) { return (double)(normals_bits(g) >> 11) * 0x1p-53; }

/* Distance from zero in the tail behind R (Marsaglia, 1964): R + x is accepted with probability exp(-x^2 / 2). */
static double normals_tail(hystmpc_normals *g) {
    double x, y;
    do {
        x = -ziggurat_inverse_end * log1p(-normals_uniform(g));
        y = -log1p(-normals_uniform(g));
    } while (!(y + y > x * x));
    return ziggurat_end + x;
}

/* Of the bits: 8 choose the layer, one the sign, 52 the place in the layer. A number in the part of the layer that the
 * curve crosses is accepted below the curve. */
static double normals_one(hystmpc_normals *g) {
    for (;;) {
        const uint64_t bits = normals_bits(g), place = bits >> 9 & 0xfffffffffffffu;
        const int layer = (int)(bits & 0xff);
        const double size = (double)place * ziggurat_width[layer], x = bits >> 8 & 1 ? -size : size;
        if (place < ziggurat_inside[layer]) return x;
        if (layer == 0) return place >> 8 & 1 ? -normals_tail(g) : normals_tail(g);
        const double below = ziggurat_height[layer], between = ziggurat_height[layer - 1] - below;
        if (between * normals_uniform(g) + below < exp(-0.5 * x * x)) return x;
    }
}

HYSTMPC_LOCAL void hystmpc_normals_init(hystmpc_normals *g, const uint64_t *seed, int64_t step) {
    const hystmpc_normals start = {{0, 0, (uint64_t)step, 0}, {seed[0], seed[1]}, {0, 0, 0, 0}, 4};
    *g = start;
}

HYSTMPC_LOCAL void hystmpc_normals_draw(hystmpc_normals *g, int count, real *numbers) {
    for (int i = 0; i < count; i++) numbers[i] = (real)normals_one(g);
}

void hystmpc_normal_numbers(const void *words, int count, real *numbers) {
    const uint64_t *const given = words;
    hystmpc_normals g;
    hystmpc_normals_init(&g, given, (int64_t)given[2]);
    hystmpc_normals_draw(&g, count, numbers);
}
