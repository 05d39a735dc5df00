/* The loop in C under datagrams of any content, on a clock and a wire of its own: it ends, nothing is read that is not
 * there, a sample in which a malformed datagram came is left to Python before anything is sent, and every command that
 * leaves is a whole datagram within the limits on value and rate.
 *
 *     fuzzed_datagrams RANDOM RUNS */
#define _POSIX_C_SOURCE 200809L
#define _DARWIN_C_SOURCE
#include <errno.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <time.h>

enum { LENGTH = 44, BODY = 40, STEPS = 60 };

static uint64_t state = 1;
static int64_t clock_ns;
static uint32_t sequence;
static unsigned rare = 1; /* how rare what is odd is in a run */
static int malformed, sent, received, taken_samples;
static double last_sent;
static volatile int asked;

static ssize_t fed_recv(int wire, void *data, size_t room, int flags);
static ssize_t checked_send(int wire, const void *data, size_t count, int flags);
static int own_clock(clockid_t which, struct timespec *t);
static int own_sleep(const struct timespec *wanted, struct timespec *left);

#define recv fed_recv
#define send checked_send
#define clock_gettime own_clock
#define nanosleep own_sleep
#include "loop.c"
#undef recv
#undef send
#undef clock_gettime
#undef nanosleep

#define LOWER 0.0
#define UPPER 6.0
#define RATE 20.0
#define DT_NS 10000000

static hystmpc_loop *loop;
static hystmpc_head head;
static hystmpc_known known;
static double no_angles[1];

static unsigned below(unsigned count) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (unsigned)(state >> 33) % count;
}

static uint64_t bits_of(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static double any_number(double usual) {
    static const double odd[] = {0.0, -0.0, 5e-324, 1e308, -1e308, 1e30, -1e30, 119.9, 120.1, -1.0, 6.1};
    const unsigned kind = below(300 * rare);
    if (kind == 0) return (double)NAN;
    if (kind == 1) return (double)INFINITY;
    if (kind == 2) return -(double)INFINITY;
    return kind < 8 ? odd[below(sizeof odd / sizeof *odd)] : usual;
}

static uint64_t any_stamp(void) {
    static const uint64_t odd[] = {0, 1, INT64_MAX, (uint64_t)INT64_MAX + 1, UINT64_MAX, UINT64_MAX - 1};
    const unsigned kind = below(200 * rare);
    if (kind < 4) return odd[below(sizeof odd / sizeof *odd)];
    if (kind == 4) return (uint64_t)clock_ns + 1000000000u * (uint64_t)below(100000);
    return (uint64_t)clock_ns - below(3000000);
}

static int own_clock(clockid_t which, struct timespec *t) {
    (void)which;
    clock_ns += below(2000);
    t->tv_sec = (time_t)(clock_ns / 1000000000), t->tv_nsec = (long)(clock_ns % 1000000000);
    return 0;
}

static int own_sleep(const struct timespec *wanted, struct timespec *left) {
    (void)left;
    clock_ns += (int64_t)wanted->tv_sec * 1000000000 + wanted->tv_nsec + below(below(50 * rare) ? 100000 : 40000000);
    return 0;
}

/* CRC-32 by its polynomial, bit by bit from the message's end, apart from that of the loop. */
static uint32_t crc_of(const uint8_t *data, int count) {
    uint32_t crc = 0xFFFFFFFFu;
    for (int k = 0; k < 8 * count; k++) {
        const uint32_t bit = (uint32_t)(data[k / 8] >> (k % 8)) & 1u;
        crc = (crc ^ bit) & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

static void put(uint8_t *at, uint64_t value, int bytes) {
    for (int k = 0; k < bytes; k++) at[k] = (uint8_t)(value >> (8 * k));
}

static uint64_t get(const uint8_t *at, int bytes) {
    uint64_t value = 0;
    for (int k = 0; k < bytes; k++) value |= (uint64_t)at[k] << (8 * k);
    return value;
}

static double real_of(const uint8_t *at) {
    const uint64_t bits = get(at, 8);
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Whether a datagram is a reading of this session, whose numbers are finite. */
static int is_whole(const uint8_t *data, size_t count) {
    static const uint8_t begin[8] = {'H', 'M', 'P', 'C', 1, 1, 0, 0};
    return count == LENGTH && memcmp(data, begin, sizeof begin) == 0 && get(data + 8, 4) == loop->session &&
           get(data + BODY, 4) == crc_of(data, BODY) && isfinite(real_of(data + 24)) && isfinite(real_of(data + 32));
}

static ssize_t fed_recv(int wire, void *to, size_t room, int flags) {
    uint8_t data[64] = {'H', 'M', 'P', 'C', 1, 1};
    size_t count = LENGTH;
    (void)wire, (void)flags;
    if (received > 0 && below(10)) {
        received = 0;
        errno = below(2) ? EAGAIN : EWOULDBLOCK;
        return -1;
    }
    received++;
    if (below(400 * rare) == 0) {
        errno = ECONNREFUSED;
        return -1;
    }
    put(data + 8, below(200 * rare) ? loop->session : below(1000), 4);
    sequence += below(100 * rare) ? 1 : below(3) ? 0 : below(1u << 31);
    put(data + 12, sequence, 4);
    put(data + 16, any_stamp(), 8);
    put(data + 24, bits_of(any_number(30.0 + (double)below(1000) / 1e4)), 8);
    put(data + 32, bits_of(any_number(last_sent)), 8);
    if (below(200 * rare) == 0) data[below(8)] = (uint8_t)below(256);
    put(data + BODY, crc_of(data, BODY), 4);
    if (below(200 * rare) == 0) data[below(LENGTH)] ^= (uint8_t)(1u << below(8));
    if (below(200 * rare) == 0) count = below(60);
    if (count > room) count = room; /* what does not fit is cut off, as by the system */
    memcpy(to, data, count);
    malformed |= !is_whole(data, count);
    return (ssize_t)count;
}

static void fail(const char *what) {
    fprintf(stderr, "%s: after %d commands, reason %d\n", what, sent, (int)loop->reason);
    abort();
}

static ssize_t checked_send(int wire, const void *from, size_t count, int flags) {
    const uint8_t *data = from;
    (void)wire, (void)flags;
    if (malformed) fail("a command in a sample with a malformed datagram");
    if (count != LENGTH || get(data + BODY, 4) != crc_of(data, BODY) || data[5] != 2) fail("not a command");
    const double u = real_of(data + 24), move = RATE * 1e-9 * DT_NS;
    if (!(LOWER <= u && u <= UPPER) || !(fabs(u - last_sent) <= move * (1.0 + 1e-9))) fail("beyond the limits");
    if (below(100 * rare) == 0) return -1;
    last_sent = u, sent++, taken_samples++;
    loop->read = loop->written;
    if (taken_samples >= STEPS) asked = 1;
    return (ssize_t)count;
}

long hystmpc_room_bytes(const void *problem) { return problem ? 64 : 0; }
int hystmpc_reference_samples(const void *problem) { return problem ? 3 : 0; }
void hystmpc_controller_hurry(const void *problem, char *memory) { (void)problem, (void)memory; }

void hystmpc_memory_at(const hystmpc_problem *p, char *memory, hystmpc_memory *m) {
    (void)p, (void)memory;
    m->head = &head, m->observed.now.known = &known, m->observed.now.angles = no_angles;
}

/* A law that answers anything. */
int hystmpc_controller_step(const void *problem, char *memory, real angle, const real *reference, void *command,
                            real *plan, char *room) {
    hystmpc_command *answer = command;
    (void)problem, (void)memory, (void)plan, (void)room;
    if (!isnan(angle) && !(loop->angle_low <= angle && angle <= loop->angle_high)) fail("an angle that is not plausible");
    for (int k = 0; k < 3; k++) (void)reference[k];
    answer->u = any_number(1.0 + (double)below(1000) / 250.0);
    answer->departure_deg = any_number(0.0);
    clock_ns += below(100 * rare) ? below(1000000) : below(50000000);
    return 0;
}

static void begin(void) {
    memset(loop, 0, sizeof *loop);
    loop->dt_ns = DT_NS, loop->dt_s = 1e-9 * DT_NS, loop->stall_ns = 500000000, loop->gap_ns = 100000000;
    loop->lower = LOWER, loop->upper = UPPER, loop->rate = RATE, loop->angle_factor = loop->command_factor = 1.0;
    loop->angle_high = 120.0, loop->angle_rate = 4000.0, loop->age_limit_s = 0.5;
    loop->tolerance = below(2) ? -1.0 : 0.5, loop->travel = below(2) ? -1.0 : 2.0;
    loop->lag_s = 0.1, loop->moves = 0.05, loop->smooth_s = 0.05, loop->frozen_travel = 3.0;
    loop->departure_bound = 5.0, loop->departures_most = 20, loop->stop_after = 25, loop->most_behind = 200;
    loop->frozen_samples = below(2) ? 0 : 25, loop->recent_most = 1 + (int)below(HYSTMPC_RECENT);
    loop->session = 7, loop->own_session = 3, loop->steps = (int64_t)below(10000), loop->end = loop->fed = loop->steps + 200;
    loop->boot_ns = loop->judged_ns = loop->gate_ns = loop->accepted_ns = loop->rated_ns = clock_ns;
    loop->heard_ns = loop->watched_ns = clock_ns, loop->deadline_ns = clock_ns + DT_NS;
    loop->angle = loop->rated = 30.0, loop->last = loop->command = last_sent = 3.0;
    loop->smooth = loop->lagged = loop->low = loop->high = loop->least = loop->most = (double)NAN;
    loop->sequence = sequence = below(2) ? 0 : UINT32_MAX - below(40);
    rare = 1 + below(30);
    asked = malformed = received = taken_samples = 0;
}

int main(int count, char **words) {
    if (count != 3) return 1;
    hystmpc_problem *problem = calloc(1, sizeof *problem);
    loop = calloc(1, sizeof *loop);
    if (!problem || !loop) return 1;
    char *room = malloc((size_t)hystmpc_loop_room_bytes(problem)), memory[1];
    int ends[10] = {0};
    state = 2u * strtoull(words[1], NULL, 10) + 1u;
    const long runs = strtol(words[2], NULL, 10);
    for (long k = 0; k < runs; k++) {
        clock_ns = 1000000000 + (int64_t)below(1u << 31) * 1000;
        begin();
        const int reason = hystmpc_loop_run(loop, problem, memory, room, (const void *)(uintptr_t)&asked);
        if (reason < 1 || reason > 8 || loop->unread < 0 || loop->unread > HYSTMPC_READINGS) fail("an odd end");
        if (malformed && reason != HYSTMPC_LOOP_ODD) fail("a malformed datagram was taken");
        ends[reason]++;
    }
    free(room), free(loop), free(problem);
    printf("%ld runs, %d commands, ends", runs, sent);
    for (int k = 1; k <= 8; k++) printf(" %d", ends[k]);
    printf("\n");
    return 0;
}
