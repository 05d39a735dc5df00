/* Blocks of chains with wrong numbers. Those that the check lets through are run with any states and numbers, each array
 * as long as chain.h says and no longer, so that a sanitizer sees every access beside it.
 *
 *     fuzzed_chains SEEDS RANDOM BLOCKS      SEEDS: a file of chains, each: size, constants, whole numbers, constants
 *
 * Compiled with -fsanitize-coverage=trace-pc, what reaches new places is kept and changed further. */
#include "check.h"
#include "follow.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_KEPT = 20000, LONGEST = 1 << 15, MOST_BYTES = 1 << 24, HEAD = 8, STAGE = 9 };

/* No chain here runs beside a network. */
int hystmpc_network_state(const hystmpc_network *network) { return network ? exit(4), 0 : 0; }
long hystmpc_network_room(const hystmpc_network *network, int rows) { return network ? exit(4), 0 : rows; }
void hystmpc_network_sample(const hystmpc_network *network, real *states, int rows, const real *u, real *theta,
                            real *work) {
    (void)network, (void)states, (void)rows, (void)u, (void)theta, (void)work;
    exit(4);
}

typedef struct {
    int size, constants;
    int *chain;
    double *numbers;
} block;

static block corpus[MOST_KEPT];
static int seeds, kept_blocks;
static uint64_t state = 1;

static unsigned below(unsigned count) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (unsigned)(state >> 33) % count;
}

#ifdef GUIDED
enum { PLACES = 1 << 16 };
static unsigned char reached[PLACES];
static uintptr_t previous;
static int news;

__attribute__((no_sanitize("address", "undefined"), no_sanitize_coverage)) void __sanitizer_cov_trace_pc(void) {
    const uintptr_t here = (uintptr_t)__builtin_return_address(0), edge = (here >> 1) ^ previous;
    unsigned char *const place = reached + (edge ^ edge >> 16) % PLACES;
    previous = here >> 2;
    if (!*place) *place = 1, news = 1;
}
#endif

static void *room_of(size_t bytes) {
    void *given = malloc(bytes ? bytes : 1);
    if (!given) exit(3);
    return given;
}

static block copy_of(const block *b) {
    block c = {b->size, b->constants, room_of((size_t)b->size * sizeof(int)), room_of((size_t)b->constants * sizeof(double))};
    memcpy(c.chain, b->chain, (size_t)b->size * sizeof(int));
    memcpy(c.numbers, b->numbers, (size_t)b->constants * sizeof(double));
    return c;
}

static void drop(const block *b) { free(b->chain), free(b->numbers); }

static double any_number(void) {
    static const double odd[] = {0.0, -0.0, 5e-324, -1e-310, 1e300, -1e300, 1e10, -1e10, 1.0, -1.0};
    const unsigned kind = below(30);
    if (kind == 0) return (double)NAN;
    if (kind == 1) return (double)INFINITY;
    if (kind == 2) return -(double)INFINITY;
    if (kind < 6) return odd[below(sizeof odd / sizeof *odd)];
    return (double)below(100001) / 1e4 - 3.0;
}

static double *any_numbers(long count) {
    double *x = room_of((size_t)count * sizeof(double));
    for (long k = 0; k < count; k++) x[k] = any_number();
    return x;
}

static double *rooms(long count) { return room_of((size_t)count * sizeof(double)); }

/* A whole number that is likely to hit something. */
static int any_whole(const block *b, int before) {
    static const int odd[] = {0, 1, 2, 3, -1, -2, INT32_MAX, INT32_MIN, 1 << 20, (1 << 20) - 1, 255, 256, 264, 4096, 65536};
    switch (below(7)) {
    case 0: return odd[below(sizeof odd / sizeof *odd)];
    case 1: return before < INT32_MAX ? before + 1 : 0;
    case 2: return before > INT32_MIN ? before - 1 : 0;
    case 3: return b->size ? b->chain[below((unsigned)b->size)] : 0;
    case 4: return (int)((unsigned)before ^ 1u << below(32));
    case 5: return (int)below((unsigned)b->size + 3);
    default: return (int)below(40);
    }
}

/* Numbers changed, swapped, copied from elsewhere or cut off. */
static void change(block *b) {
    const unsigned times = 1 + below(below(4) ? 2 : 10);
    for (unsigned k = 0; k < times && b->size > 0; k++) {
        const unsigned size = (unsigned)b->size, at = below(4) ? below(size) : below(size < 40 ? size : 40), kind = below(12);
        if (kind == 0) {
            const unsigned other = below(size);
            const int here = b->chain[at];
            b->chain[at] = b->chain[other], b->chain[other] = here;
        } else if (kind == 1) {
            const unsigned other = below(size), length = below(1 + (at > other ? size - at : size - other));
            memmove(b->chain + at, b->chain + other, length * sizeof(int));
        } else if (kind == 2 && below(4) == 0) {
            b->size = (int)below(size + 1);
        } else if (kind == 3 && below(4) == 0) {
            b->constants = (int)below((unsigned)b->constants + 1);
        } else if (kind == 4) {
            const block *const other = corpus + below((unsigned)kept_blocks);
            const unsigned length = other->size ? below(1 + (size - at < (unsigned)other->size ? size - at : (unsigned)other->size)) : 0;
            memcpy(b->chain + at, other->chain + below((unsigned)other->size - length + 1), length * sizeof(int));
        } else {
            b->chain[at] = any_whole(b, b->chain[at]);
        }
    }
}

static int fits(long bytes) { return bytes >= 0 && bytes <= MOST_BYTES; }

/* The most registers of phase `once`. */
static int registers_of(const int *c) {
    int most = 0;
    for (int k = 0; k < c[0]; k++) {
        const int registers = c[c[HEAD + c[6] + STAGE * k] + 9];
        if (registers > most) most = registers;
    }
    return most;
}

/* Free runs, in one row and in several, whole arrays in any order of rows and samples. */
static void run_free(const int *c, const double *numbers, double *parameters, int rows, int samples, int each) {
    const long bytes = hystmpc_chain_bytes(c, rows, 0), points = (long)rows * samples;
    const int kept_rows = each ? rows : 1, stride[3] = {samples * rows, rows, 1}, states[2] = {rows, 1};
    if (!fits(bytes) || !fits(8L * points * c[5]) || !fits(8L * points * c[6]) || !fits(8L * rows * c[3])) return;
    double *kept = rooms((long)c[3] * kept_rows), *room = rooms(registers_of(c)), *u = any_numbers(points * c[5]);
    double *x = any_numbers((long)c[1] * rows), *y = rooms(points * c[6]);
    char *memory = room_of((size_t)bytes);
    hystmpc_chain_prepare(c, numbers, parameters, kept_rows, 0.01, kept, room);
    hystmpc_chain_simulate(c, kept, kept_rows, rows, samples, u, stride, NULL, x, states, (int)below(2), y, stride, memory);
    free(kept), free(room), free(u), free(x), free(y), free(memory);
}

/* Runs with derivatives. */
static void differentiate(const int *c, const double *kept, int runs, int samples, int directions) {
    const long bytes = hystmpc_chain_bytes(c, runs, directions);
    int first[8] = {0};
    for (int n = 0; n < runs; n++) first[n + 1] = first[n] + (int)below((unsigned)samples + 1);
    const long total = first[runs], d = directions;
    if (!fits(bytes) || !fits(8 * total * d * (c[5] + c[6])) || !fits(8 * d * c[2]) || !fits(8 * d * runs * c[1])) return;
    double *u = any_numbers(total * c[5]), *du = below(2) ? any_numbers(total * d * c[5]) : NULL;
    double *at = any_numbers(d * c[2]), *x = any_numbers((long)runs * c[1]), *m = any_numbers(d * runs * c[1]);
    double *y = rooms(total * c[6]), *dy = rooms(total * d * c[6]);
    char *memory = room_of((size_t)bytes);
    for (long k = 0; k < d * c[2]; k++)
        if (below(3)) at[k] = 0.0;
    for (long k = 0; k < d * runs * c[1]; k++)
        if (below(3)) m[k] = 0.0;
    hystmpc_chain_differentiate(c, kept, runs, first, u, du, directions, at, x, m, y, dy, memory);
    free(u), free(du), free(at), free(x), free(m), free(y), free(dy), free(memory);
}

/* Plans and their slopes; scheduled inputs are known or not. */
static void run_plans(const int *c, const double *kept, int samples) {
    const long h = samples, nu = c[5] - c[7], ny = c[6];
    const long sizes[] = {hystmpc_chain_bytes(c, 5, 0), hystmpc_chain_linearise_bytes(c, samples)};
    if (!fits(sizes[0]) || !fits(sizes[1]) || !fits(8 * 5 * h * (nu + ny)) || !fits(8 * ny * h * nu * h)) return;
    double *x = any_numbers(c[1]), *plans = any_numbers(5 * nu * h), *known = below(3) ? any_numbers(c[7] * h) : NULL;
    double *y = rooms(5 * ny * h), *dy = rooms(ny * h * nu * h);
    char *memory = room_of((size_t)sizes[0]);
    hystmpc_chain_roll_out(c, kept, x, 5, samples, plans, known, y, memory);
    free(memory), memory = room_of((size_t)sizes[1]);
    hystmpc_chain_linearise(c, kept, x, plans, known, samples, y, dy, memory);
    free(x), free(plans), free(known), free(y), free(dy), free(memory);
}

/* What has one input and one output: one sample, inverses. */
static void run_axis(const int *c, const double *kept, int samples) {
    const long h = samples, sizes[] = {hystmpc_chain_single_bytes(c), hystmpc_follow_bytes(c, NULL),
                                       hystmpc_lead_drive_bytes(c, samples)};
    const double bounds[3] = {0.0, 6.0, any_number()}, inverted[2] = {-1.0, 7.0};
    for (unsigned k = 0; k < sizeof sizes / sizeof *sizes; k++)
        if (!fits(sizes[k])) return;
    double *x = any_numbers(c[1]), *plans = any_numbers(h), *y = rooms(2 * h);
    char *memory = room_of((size_t)sizes[0]);
    (void)hystmpc_chain_command_for(c, kept, x, any_number(), any_number(), any_number(), any_number(), memory);
    (void)hystmpc_chain_step(c, kept, x, any_number(), memory);
    free(memory), memory = room_of((size_t)sizes[1]);
    hystmpc_follow(c, kept, NULL, x, plans, samples, any_number(), bounds, inverted, y, memory);
    free(memory), memory = room_of((size_t)sizes[2]);
    (void)hystmpc_lead_drive(c, kept, x, plans, samples, any_number(), 0.1, y, y + h, memory);
    free(x), free(plans), free(y), free(memory);
}

/* States at rest of every stage that has them. */
static void run_rest(const int *c, const double *numbers) {
    for (int k = 0; k < c[0]; k++) {
        const int *const place = c + HEAD + c[6] + STAGE * k, *const table = c + place[0];
        const long rows = 3, d = 2, states = table[1], count = table[3];
        if (place[1] < 0) continue;
        double *u = any_numbers(rows), *du = any_numbers(rows * d), *seen = any_numbers(rows), *dseen = any_numbers(rows * d);
        double *p = any_numbers(count * rows), *at = any_numbers(count * d), *x = rooms(states * rows);
        double *m = rooms(states * rows * d), *room = rooms(hystmpc_chain_rest_room(c, k));
        hystmpc_chain_rest(c, numbers, k, 3, u, du, seen, dseen, p, 3, 2, at, x, m, room);
        hystmpc_chain_rest(c, numbers, k, 3, u, du, seen, dseen, p, 1, 2, at, x, m, room);
        free(u), free(du), free(seen), free(dseen), free(p), free(at), free(x), free(m), free(room);
    }
}

/* The whole chain at rest, its core at any stage or none. */
static void run_settled(const int *c, const double *numbers, const double *parameters, const double *kept, int rows) {
    const long d = 2, bytes = hystmpc_chain_settle_bytes(c, rows, (int)d);
    if (!fits(bytes) || !fits(8L * rows * c[1] * d)) return;
    double *u = any_numbers(rows), *y = any_numbers(rows), *at = any_numbers(d * c[2]);
    double *x = rooms((long)rows * c[1]), *m = rooms(d * rows * c[1]);
    char *memory = room_of((size_t)bytes);
    hystmpc_chain_settle(c, numbers, kept, (int)below((unsigned)c[0] + 2) - 1, rows, u, y, parameters, (int)d, at, x, m,
                         memory);
    free(u), free(y), free(at), free(x), free(m), free(memory);
}

/* 1 if the check lets it through. */
static int try_block(const block *b) {
    const block own = copy_of(b);
    const int *const c = own.chain, sound = hystmpc_chain_check(c, own.size, own.constants) == HYSTMPC_SOUND;
    if (sound && fits(8L * 5 * c[2]) && fits(8L * 5 * c[3])) {
        double *parameters = any_numbers(5L * c[2]), *kept = rooms(c[3]), *room = rooms(registers_of(c));
        hystmpc_chain_prepare(c, own.numbers, parameters, 1, 0.01, kept, room);
        run_free(c, own.numbers, parameters, 1 + (int)below(5), 1 + (int)below(below(4) ? 12 : 300), (int)below(2));
        differentiate(c, kept, 1 + (int)below(7), (int)below(below(4) ? 12 : 300), 1 + (int)below(3));
        run_plans(c, kept, 1 + (int)below(12));
        if (c[5] == 1 && c[6] == 1) {
            run_axis(c, kept, 1 + (int)below(12));
            run_settled(c, own.numbers, parameters, kept, 1 + (int)below(40));
        }
        run_rest(c, own.numbers);
        free(parameters), free(kept), free(room);
    }
    drop(&own);
    return sound;
}

static int read_seeds(const char *path) {
    FILE *file = fopen(path, "rb");
    int head[2];
    if (!file) return 0;
    while (fread(head, sizeof(int), 2, file) == 2 && head[0] <= LONGEST) {
        block b = {head[0], head[1], room_of((size_t)head[0] * sizeof(int)), room_of((size_t)head[1] * sizeof(double))};
        if (fread(b.chain, sizeof(int), (size_t)b.size, file) != (size_t)b.size) return 0;
        if (fread(b.numbers, sizeof(double), (size_t)b.constants, file) != (size_t)b.constants) return 0;
        corpus[seeds++] = b;
    }
    fclose(file);
    kept_blocks = seeds;
    return seeds > 0;
}

int main(int count, char **words) {
    if (count != 4 || !read_seeds(words[1])) return 1;
    state = strtoull(words[2], NULL, 10) * 2u + 1u;
    const long blocks = strtol(words[3], NULL, 10);
    long passed = 0;
    for (int k = 0; k < seeds; k++)
        if (!try_block(corpus + k)) return 2;
    for (long k = 0; k < blocks; k++) {
        block b = copy_of(corpus + below((unsigned)kept_blocks));
        change(&b);
        const int sound = try_block(&b);
        passed += sound;
#ifdef GUIDED
        previous = 0;
        if (news && kept_blocks < MOST_KEPT) corpus[kept_blocks++] = copy_of(&b);
        news = 0;
        if (k % 50000 == 0) fprintf(stderr, "%ld blocks, %ld passed, %d kept\n", k, passed, kept_blocks);
#endif
        drop(&b);
    }
    for (int k = 0; k < kept_blocks; k++) drop(corpus + k);
    printf("%ld blocks, %ld passed\n", blocks, passed);
    return 0;
}
