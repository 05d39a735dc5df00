/* The samples of a run, see loop.h. */
#define _POSIX_C_SOURCE 200809L
#define _DARWIN_C_SOURCE /* MSG_DONTWAIT, CLOCK_UPTIME_RAW */

#include "loop.h"
#include "room.h"

#if defined(_WIN32) || HYSTMPC_SINGLE

long hystmpc_loop_room_bytes(const void *problem) { return hystmpc_room_bytes(problem); }

int hystmpc_loop_run(void *loop, const void *problem, char *memory, char *room, const void *asked) {
    hystmpc_loop *l = loop;
    (void)problem, (void)memory, (void)room, (void)asked;
    return l->reason = HYSTMPC_LOOP_ABSENT;
}

long hystmpc_loop_written(const void *loop) {
    (void)loop;
    return 0;
}

#else

#include <errno.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <time.h>

#define LOOP_S(ns) (1e-9 * (double)(ns))

enum { LOOP_DATAGRAM = 44, LOOP_BODY = 40, LOOP_HALF = 1 << 30, LOOP_RATE_NS = 20000000 };

#define LOOP_DRIFT 500e-6 /* of two clocks, see `Intake` */

#ifdef CLOCK_UPTIME_RAW /* macOS: the clock of Python's `time.monotonic` */
#define LOOP_CLOCK CLOCK_UPTIME_RAW
#else
#define LOOP_CLOCK CLOCK_MONOTONIC
#endif

long hystmpc_loop_written(const void *loop) {
    const hystmpc_loop *l = loop;
    return (long)__atomic_load_n(&l->written, __ATOMIC_ACQUIRE);
}

static int64_t loop_now_of(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static int64_t loop_now_ns(void) { return loop_now_of(LOOP_CLOCK); }

#ifdef CLOCK_BOOTTIME
static int64_t loop_boot_now_ns(void) { return loop_now_of(CLOCK_BOOTTIME); }
#else
static int64_t loop_boot_now_ns(void) { return loop_now_ns(); }
#endif

static void loop_wait_until(int64_t deadline_ns, int64_t spin_ns) {
    for (;;) {
        const int64_t left = deadline_ns - loop_now_ns() - spin_ns;
        if (left <= 0) break;
        const struct timespec t = {(time_t)(left / 1000000000), (long)(left % 1000000000)};
        nanosleep(&t, NULL);
    }
    while (loop_now_ns() < deadline_ns) continue;
}

/* CRC-32 of zlib and of IEEE 802.3. */
static uint32_t loop_checksum(const unsigned char *data, int count) {
    uint32_t crc = 0xFFFFFFFFu;
    for (int i = 0; i < count; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static uint64_t loop_number_at(const unsigned char *data, int bytes) {
    uint64_t value = 0;
    for (int i = bytes - 1; i >= 0; i--) value = value << 8 | data[i];
    return value;
}

static double loop_real_at(const unsigned char *data) {
    const uint64_t bits = loop_number_at(data, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void loop_put_number(unsigned char *data, uint64_t value, int bytes) {
    for (int i = 0; i < bytes; i++, value >>= 8) data[i] = (unsigned char)(value & 0xFFu);
}

/* A command as a datagram, see `rig/transports/udp.py`. */
static int loop_send_command(hystmpc_loop *l, double u) {
    unsigned char data[LOOP_DATAGRAM] = {'H', 'M', 'P', 'C', 1, 2};
    const double raw = u / l->command_factor;
    uint64_t bits;
    memcpy(&bits, &raw, sizeof bits);
    l->sent_sequence++;
    loop_put_number(data + 8, l->own_session, 4);
    loop_put_number(data + 12, l->sent_sequence, 4);
    loop_put_number(data + 16, (uint64_t)loop_now_ns(), 8);
    loop_put_number(data + 24, bits, 8);
    loop_put_number(data + LOOP_BODY, loop_checksum(data, LOOP_BODY), 4);
    return send(l->descriptor, data, LOOP_DATAGRAM, 0) == LOOP_DATAGRAM;
}

/* Whether a reading is as expected, as `Intake` judges it; then it is taken. */
static int loop_taken(hystmpc_loop *l, const hystmpc_reading *r, int64_t woke_ns, double *held) {
    static const unsigned char head[8] = {'H', 'M', 'P', 'C', 1, 1, 0, 0};
    const uint8_t *data = r->data;
    if (memcmp(data, head, sizeof head) != 0) return 0;
    if (loop_checksum(data, LOOP_BODY) != loop_number_at(data + LOOP_BODY, 4)) return 0;
    const uint32_t ahead = (uint32_t)loop_number_at(data + 12, 4) - l->sequence;
    if (loop_number_at(data + 8, 4) != l->session || ahead == 0 || ahead > LOOP_HALF) return 0;
    l->sequence += ahead;
    const uint64_t stamp_ns = loop_number_at(data + 16, 8);
    if (stamp_ns > INT64_MAX) return 0; /* the difference would have no number */
    const double flight = (double)(r->received_ns - (int64_t)stamp_ns);
    l->flight_ns = least(flight, l->flight_ns + LOOP_DRIFT * most((double)(r->received_ns - l->heard_ns), 0.0));
    l->heard_ns = r->received_ns;
    const double excess = flight - l->flight_ns;
    if (!(1e-9 * ((double)(woke_ns - r->received_ns) + excess) <= l->age_limit_s)) return 0;
    const double angle = l->angle_factor * loop_real_at(data + 24) + l->angle_offset;
    const double elapsed_s = most(LOOP_S(r->received_ns - l->rated_ns), LOOP_S(LOOP_RATE_NS));
    *held = l->command_factor * loop_real_at(data + 32);
    if (!(l->angle_low <= angle && angle <= l->angle_high && is_finite(*held))) return 0;
    if (!(absolute(angle - l->rated) <= l->angle_rate * elapsed_s) || r->received_ns < l->accepted_ns) return 0;
    if (angle == l->angle) {
        if (l->repeats < INT32_MAX) l->repeats++;
        if (l->frozen_samples > 0 && l->repeats >= l->frozen_samples && l->travelled >= l->frozen_travel) return 0;
    } else {
        l->repeats = 0;
        l->travelled = 0.0;
    }
    l->angle = angle;
    l->accepted_ns = r->received_ns;
    if (r->received_ns - l->rated_ns >= LOOP_RATE_NS) {
        l->rated_ns = r->received_ns;
        l->rated = angle;
    }
    return 1;
}

/* Read what has come, into `pending`; 0 where it is not as expected. The angle stays not-a-number where none came. */
static int loop_look(hystmpc_loop *l, int64_t woke_ns, double *angle, double *held) {
    int expected = 1;
    l->travelled += absolute(l->last - l->command);
    l->command = l->last;
    for (l->unread = 0; expected; l->unread++) {
        hystmpc_reading *r = &l->pending[l->unread];
        if (l->unread == HYSTMPC_READINGS) return 0;
        const ssize_t count = recv(l->descriptor, r->data, sizeof r->data, MSG_DONTWAIT);
        if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) break;
        if (count < 0) return 0;
        r->received_ns = loop_now_ns();
        r->size = (int32_t)count;
        expected = count == LOOP_DATAGRAM && loop_taken(l, r, woke_ns, held);
        *angle = l->angle;
    }
    return expected && LOOP_S(woke_ns - l->accepted_ns) <= l->age_limit_s;
}

/* Whether what the device holds lies within what was sent lately, as `DriveFollowing` has it over a longer time. */
static int loop_follows(hystmpc_loop *l, double held) {
    double low = l->last, high = l->last;
    l->recent[l->recent_next] = l->last;
    l->recent_next = (l->recent_next + 1) % l->recent_most;
    if (l->recent_count < l->recent_most) l->recent_count++;
    if (l->tolerance < 0.0 || held != held) return 1;
    for (int i = 0; i < l->recent_count; i++) {
        low = least(low, l->recent[i]);
        high = most(high, l->recent[i]);
    }
    return low - l->tolerance <= held && held <= high + l->tolerance;
}

static double loop_followed(double lagged, double value, double share) {
    return lagged != lagged ? value : lagged + (1.0 - exp(-share)) * (value - lagged);
}

/* Whether the angle moves as the command does, as `MotionWatch` has it at its strictest; its direction is for Python. */
static int loop_moves(hystmpc_loop *l, double angle, int64_t woke_ns) {
    const double elapsed_s = most(LOOP_S(woke_ns - l->watched_ns), 0.0);
    if (l->travel < 0.0 || angle != angle) return 1;
    l->smooth = loop_followed(l->smooth, angle, elapsed_s / l->smooth_s);
    l->lagged = loop_followed(l->lagged, l->last, elapsed_s / l->lag_s);
    l->watched_ns = woke_ns;
    if (!(most(l->high, l->smooth) - least(l->low, l->smooth) < l->moves)) {
        l->low = l->high = l->smooth;
        l->least = l->most = l->lagged;
        return 1;
    }
    l->low = least(l->low, l->smooth);
    l->high = most(l->high, l->smooth);
    l->least = least(l->least, l->lagged);
    l->most = most(l->most, l->lagged);
    return l->most - l->least < l->travel;
}

/* The last check before the wire, as `Gate` has it. */
static double loop_admissible(const hystmpc_loop *l, double wanted, int64_t at_ns) {
    const double elapsed = least(most(LOOP_S(at_ns - l->gate_ns), 0.1 * l->dt_s), l->dt_s);
    const double last = clamp(l->last, l->lower, l->upper);
    const double low = most(l->lower, last - l->rate * elapsed), high = least(l->upper, last + l->rate * elapsed);
    return clamp(is_finite(wanted) ? wanted : l->last, low, high);
}

/* The controller of a run: its memory, and room for a preview and a step. */
typedef struct {
    const hystmpc_problem *problem;
    char *memory, *room;
    real *wanted;
    int preview;
    hystmpc_memory parts;
    const volatile int *asked;
} loop_controller;

/* Why Python has to take the next sample, as far as that is known before: it then has the time until it is due. */
static int loop_foreseen(const hystmpc_loop *l, const loop_controller *c) {
    const hystmpc_head *head = c->parts.head;
    const int64_t next = l->steps + l->skipped + 1;
    if (*c->asked || l->asked) return HYSTMPC_LOOP_ASKED;
    if (l->written - l->read >= l->most_behind) return HYSTMPC_LOOP_UNWATCHED;
    if (next + c->preview > l->fed || next > l->end) return HYSTMPC_LOOP_UNFED;
    if (head->stopped || head->failures + 1 >= l->stop_after || 2 * l->departures >= l->departures_most)
        return HYSTMPC_LOOP_FAILING;
    return 0;
}

/* Wait for the next sample and judge it; 0, or why Python has to take it. */
static int loop_begin(hystmpc_loop *l, const loop_controller *c, hystmpc_sample *s, double *angle) {
    double held = (real)NAN;
    const int reason = loop_foreseen(l, c);
    if (reason) return reason;
    l->unread = 0;
    loop_wait_until(l->deadline_ns, l->spin_ns);
    s->deadline_ns = l->deadline_ns;
    s->woke_ns = loop_now_ns();
    s->boot_ns = loop_boot_now_ns();
    if (s->boot_ns - l->boot_ns > l->stall_ns + l->dt_ns || s->boot_ns - l->judged_ns > l->gap_ns)
        return HYSTMPC_LOOP_STOOD;
    if (*c->asked || l->asked) return HYSTMPC_LOOP_ASKED;
    if (!loop_look(l, s->woke_ns, angle, &held)) return HYSTMPC_LOOP_ODD;
    if (!loop_follows(l, held) || !loop_moves(l, *angle, s->woke_ns)) return HYSTMPC_LOOP_STRAYED;
    l->boot_ns = s->boot_ns;
    return 0;
}

static void loop_step(hystmpc_loop *l, const loop_controller *c, double angle, hystmpc_sample *s) {
    const hystmpc_known *known = c->parts.observed.now.known;
    const int64_t began_ns = loop_now_ns();
    for (int k = 0; k < c->preview; k++) c->wanted[k] = (real)NAN;
    for (int k = 0; k < l->skipped; k++) /* nothing was sent: the controller holds */
        hystmpc_controller_step(c->problem, c->memory, (real)NAN, c->wanted, &s->answer, NULL, c->room);
    l->steps += l->skipped;
    for (int k = 0; k < c->preview; k++) c->wanted[k] = l->reference[(l->steps + 1 + k) % HYSTMPC_REFERENCES];
    if (l->late || l->skipped) hystmpc_controller_hurry(c->problem, c->memory);
    hystmpc_controller_step(c->problem, c->memory, angle, c->wanted, &s->answer, NULL, c->room);
    l->steps++;
    s->skipped = l->skipped;
    s->angle_deg = angle;
    s->due_deg = c->parts.head->due;
    s->level = c->parts.head->level;
    s->failures = c->parts.head->failures;
    s->stalled = known->stalled;
    s->forecast_error = known->forecast_error;
    s->model_deg = c->problem->model ? c->parts.observed.now.angles[0] - known->added : (real)NAN;
    l->departures = absolute(s->answer.departure_deg) >= l->departure_bound ? l->departures + 1 : 0;
    s->step_ns = loop_now_ns() - began_ns;
}

/* Send the command of a sample within the limits; what has not left counts as never sent. */
static void loop_deliver(hystmpc_loop *l, hystmpc_sample *s) {
    s->checked_ns = loop_now_ns();
    s->u = loop_admissible(l, s->answer.u, s->checked_ns);
    s->sent_boot_ns = loop_boot_now_ns();
    s->sent = s->sent_boot_ns - s->boot_ns <= l->gap_ns && loop_send_command(l, s->u);
    s->sent_ns = loop_now_ns();
    if (!s->sent) return;
    l->last = s->u;
    l->gate_ns = s->sent_ns;
    l->judged_ns = s->boot_ns;
}

/* Write down what a sample was, and set the time of the next one. */
static void loop_conclude(hystmpc_loop *l, hystmpc_sample *s) {
    s->readings = l->unread;
    memcpy(s->reading, l->pending, (size_t)l->unread * sizeof(hystmpc_reading));
    l->unread = 0;
    s->wall_ns = loop_now_of(CLOCK_REALTIME);
    s->done_ns = loop_now_ns();
    const int64_t behind = s->done_ns - l->deadline_ns - l->dt_ns;
    l->late = behind > 0;
    l->skipped = behind > 0 ? (int32_t)(behind / l->dt_ns) : 0;
    l->deadline_ns += (1 + (int64_t)l->skipped) * l->dt_ns;
    __atomic_store_n(&l->written, l->written + 1, __ATOMIC_RELEASE);
}

long hystmpc_loop_room_bytes(const void *problem) {
    return ROOM_LINE + room_for(hystmpc_reference_samples(problem)) + hystmpc_room_bytes(problem);
}

int hystmpc_loop_run(void *loop, const void *problem, char *memory, char *room, const void *asked) {
    hystmpc_loop *l = loop;
    loop_controller c = {.problem = problem, .memory = memory, .asked = asked};
    hystmpc_memory_at(problem, memory, &c.parts);
    c.preview = hystmpc_reference_samples(problem);
    c.room = room_begin(room);
    c.wanted = room_take(&c.room, c.preview);
    for (;;) {
        hystmpc_sample *s = &l->samples[l->written % HYSTMPC_SAMPLES];
        double angle = (real)NAN;
        l->reason = loop_begin(l, &c, s, &angle);
        if (l->reason) return l->reason;
        loop_step(l, &c, angle, s);
        loop_deliver(l, s);
        loop_conclude(l, s);
        if (!s->sent) return l->reason = HYSTMPC_LOOP_UNSENT;
    }
}

#undef LOOP_S
#undef LOOP_DRIFT
#undef LOOP_CLOCK

#endif
