/* Samples of a run in C: wait, read, judge, step, limit, send, write down.
 *
 * A sample is taken here only while all is as expected. The first that is not is left to the Python loop, undecided:
 * with what it has read, and before anything is sent. So the rules of what to do in a fault stand in Python alone; here
 * stands when they may be needed. Python looks at every sample that was taken here within some samples, by its own
 * rules, and where it does not keep up the loop ends, too. */
#define _POSIX_C_SOURCE 200809L

#include "hystmpc.h"

#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <time.h>

#define S(ns) (1e-9 * (double)(ns))

enum { DATAGRAM = 44, BODY = 40, HALF = 1 << 30, RATE_NS = 20000000 };

#define DRIFT 500e-6 /* of two clocks, see `Intake` */

/* Why the loop has ended: the sample at `deadline_ns` is to be taken by Python. */
enum {
    ASKED = 1,     /* a stop, an end or another target */
    STOOD = 2,     /* the process has stood still */
    UNWATCHED = 3, /* Python does not keep up */
    UNFED = 4,     /* the reference is not known far enough, or at its end */
    ODD = 5,       /* a reading that is not as expected, or none for too long */
    STRAYED = 6,   /* what the device holds, or how it moves, may be a fault */
    FAILING = 7,   /* the controller is about to stop, or its model is off */
    UNSENT = 8     /* a command has not left */
};

typedef struct {
    int64_t received_ns;
    int32_t size; /* of the datagram, 48 where it is longer */
    uint8_t data[48];
} hystmpc_reading;

/* What a sample was. */
typedef struct {
    int64_t deadline_ns, woke_ns, boot_ns, checked_ns, sent_boot_ns, sent_ns, done_ns, wall_ns, step_ns;
    double wanted, u; /* the controller's command, and the one within the limits */
    double angle_deg, predicted_deg, departure_deg, model_deg, due_deg, forecast_error;
    int32_t source, status, missing, stalled, level, failures;
    int32_t sent;    /* whether the command has left */
    int32_t skipped; /* whole samples that had passed before it */
    int32_t readings;
    hystmpc_reading reading[READINGS];
} hystmpc_sample;

typedef struct {
    /* What Python sets before the loop begins. */
    int64_t dt_ns, spin_ns, stall_ns, gap_ns;
    double dt_s, lower, upper, rate;                                               /* last check before the wire */
    double angle_factor, angle_offset, command_factor;                             /* of the wire's units */
    double angle_low, angle_high, angle_rate, age_limit_s, tolerance, frozen_travel; /* of the sensor; tolerance < 0: none */
    double travel, lag_s, moves, smooth_s;              /* motion watch; travel < 0: none */
    double departure_bound;
    int32_t descriptor, frozen_samples, recent_most, stop_after, departures_most, most_behind;
    uint32_t session, own_session;
    /* What changes; Python sets how it begins, and finds how it ended. */
    int64_t deadline_ns, boot_ns, accepted_ns, rated_ns, heard_ns, gate_ns, judged_ns, watched_ns;
    double flight_ns, angle, rated, travelled, command; /* of the intake */
    double last;                                        /* of the gate: sent last */
    double smooth, lagged, low, high, least, most;      /* of the motion watch */
    double recent[RECENT];                              /* commands sent lately */
    int64_t steps;                                      /* of the controller's clock */
    int64_t end;                                        /* steps after which the reference is over */
    int32_t repeats, recent_count, recent_next, departures, late, skipped, unread, reason;
    uint32_t sequence, sent_sequence;
    hystmpc_reading pending[READINGS];                  /* read, not decided */
    /* Between the two, each written by one side alone. */
    volatile int64_t written, read;                     /* samples */
    volatile int64_t fed;                               /* reference samples that are known */
    volatile int32_t asked;                             /* whether to end: what is tracked has changed */
    double reference[REFERENCES];                       /* by number of the sample, around the end */
    hystmpc_sample samples[SAMPLES];
} hystmpc_loop;

unsigned long hystmpc_loop_bytes(void) { return (unsigned long)sizeof(hystmpc_loop); }

/* How many samples are written down, whole. */
int64_t hystmpc_loop_written(const hystmpc_loop *l) { return __atomic_load_n(&l->written, __ATOMIC_ACQUIRE); }

static int64_t now_of(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static int64_t now_ns(void) { return now_of(CLOCK_MONOTONIC); }

#ifdef CLOCK_BOOTTIME
static int64_t boot_now_ns(void) { return now_of(CLOCK_BOOTTIME); }
#else
static int64_t boot_now_ns(void) { return now_ns(); }
#endif

static void wait_until(int64_t deadline_ns, int64_t spin_ns) {
    for (;;) {
        const int64_t left = deadline_ns - now_ns() - spin_ns;
        if (left <= 0) break;
        const struct timespec t = {(time_t)(left / 1000000000), (long)(left % 1000000000)};
        nanosleep(&t, NULL);
    }
    while (now_ns() < deadline_ns) continue;
}

/* CRC-32 of zlib and of IEEE 802.3. */
static uint32_t checksum(const unsigned char *data, int count) {
    uint32_t crc = 0xFFFFFFFFu;
    for (int i = 0; i < count; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static uint64_t number_at(const unsigned char *data, int bytes) {
    uint64_t value = 0;
    for (int i = bytes - 1; i >= 0; i--) value = value << 8 | data[i];
    return value;
}

static double real_at(const unsigned char *data) {
    const uint64_t bits = number_at(data, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void put_number(unsigned char *data, uint64_t value, int bytes) {
    for (int i = 0; i < bytes; i++, value >>= 8) data[i] = (unsigned char)(value & 0xFFu);
}

/* A command as a datagram, see `rig/transports/udp.py`. */
static int send_command(hystmpc_loop *l, double u) {
    unsigned char data[DATAGRAM] = {'H', 'M', 'P', 'C', 1, 2};
    const double raw = u / l->command_factor;
    uint64_t bits;
    memcpy(&bits, &raw, sizeof bits);
    l->sent_sequence++;
    put_number(data + 8, l->own_session, 4);
    put_number(data + 12, l->sent_sequence, 4);
    put_number(data + 16, (uint64_t)now_ns(), 8);
    put_number(data + 24, bits, 8);
    put_number(data + BODY, checksum(data, BODY), 4);
    return send(l->descriptor, data, DATAGRAM, 0) == DATAGRAM;
}

static int plain_number(double x) { return x - x == 0.0; }
static double least_of(double a, double b) { return b < a ? b : a; }
static double most_of(double a, double b) { return b > a ? b : a; }

/* Whether a reading is as expected, as `Intake` judges it; then it is taken. */
static int taken(hystmpc_loop *l, const hystmpc_reading *r, int64_t woke_ns, double *held) {
    static const unsigned char head[8] = {'H', 'M', 'P', 'C', 1, 1, 0, 0};
    const uint8_t *data = r->data;
    if (memcmp(data, head, sizeof head) != 0 || checksum(data, BODY) != number_at(data + BODY, 4)) return 0;
    const uint32_t ahead = (uint32_t)number_at(data + 12, 4) - l->sequence;
    if (number_at(data + 8, 4) != l->session || ahead == 0 || ahead > HALF) return 0;
    l->sequence += ahead;
    const double flight = (double)(r->received_ns - (int64_t)number_at(data + 16, 8));
    l->flight_ns = least_of(flight, l->flight_ns + DRIFT * most_of((double)(r->received_ns - l->heard_ns), 0.0));
    l->heard_ns = r->received_ns;
    const double excess = flight - l->flight_ns;
    if (!(1e-9 * ((double)(woke_ns - r->received_ns) + excess) <= l->age_limit_s)) return 0;
    const double angle = l->angle_factor * real_at(data + 24) + l->angle_offset;
    const double elapsed_s = most_of(S(r->received_ns - l->rated_ns), S(RATE_NS));
    *held = l->command_factor * real_at(data + 32);
    if (!(l->angle_low <= angle && angle <= l->angle_high && plain_number(*held))) return 0;
    if (!(fabs(angle - l->rated) <= l->angle_rate * elapsed_s) || r->received_ns < l->accepted_ns) return 0;
    if (angle == l->angle) {
        l->repeats++;
        if (l->frozen_samples > 0 && l->repeats >= l->frozen_samples && l->travelled >= l->frozen_travel) return 0;
    } else {
        l->repeats = 0;
        l->travelled = 0.0;
    }
    l->angle = angle;
    l->accepted_ns = r->received_ns;
    if (r->received_ns - l->rated_ns >= RATE_NS) {
        l->rated_ns = r->received_ns;
        l->rated = angle;
    }
    return 1;
}

/* Read what has come, into `pending`; 0 where it is not as expected. The angle stays not-a-number where none came. */
static int look(hystmpc_loop *l, int64_t woke_ns, double *angle, double *held) {
    int expected = 1;
    l->travelled += fabs(l->last - l->command);
    l->command = l->last;
    for (l->unread = 0; expected; l->unread++) {
        hystmpc_reading *r = &l->pending[l->unread];
        if (l->unread == READINGS) return 0;
        const ssize_t count = recv(l->descriptor, r->data, sizeof r->data, MSG_DONTWAIT);
        if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) break;
        if (count < 0) return 0;
        r->received_ns = now_ns();
        r->size = (int32_t)count;
        expected = count == DATAGRAM && taken(l, r, woke_ns, held);
        *angle = l->angle;
    }
    return expected && S(woke_ns - l->accepted_ns) <= l->age_limit_s;
}

/* Whether what the device holds lies within what was sent lately, as `DriveFollowing` has it over a longer time. */
static int follows(hystmpc_loop *l, double held) {
    double low = l->last, high = l->last;
    l->recent[l->recent_next] = l->last;
    l->recent_next = (l->recent_next + 1) % l->recent_most;
    if (l->recent_count < l->recent_most) l->recent_count++;
    if (l->tolerance < 0.0 || held != held) return 1;
    for (int i = 0; i < l->recent_count; i++) {
        low = least_of(low, l->recent[i]);
        high = most_of(high, l->recent[i]);
    }
    return low - l->tolerance <= held && held <= high + l->tolerance;
}

static double followed(double lagged, double value, double share) {
    return lagged != lagged ? value : lagged + (1.0 - exp(-share)) * (value - lagged);
}

/* Whether the angle moves as the command does, as `MotionWatch` has it at its strictest; Python watches its direction. */
static int moves(hystmpc_loop *l, double angle, int64_t woke_ns) {
    const double elapsed_s = most_of(S(woke_ns - l->watched_ns), 0.0);
    if (l->travel < 0.0 || angle != angle) return 1;
    l->smooth = followed(l->smooth, angle, elapsed_s / l->smooth_s);
    l->lagged = followed(l->lagged, l->last, elapsed_s / l->lag_s);
    l->watched_ns = woke_ns;
    if (!(most_of(l->high, l->smooth) - least_of(l->low, l->smooth) < l->moves)) {
        l->low = l->high = l->smooth;
        l->least = l->most = l->lagged;
        return 1;
    }
    l->low = least_of(l->low, l->smooth);
    l->high = most_of(l->high, l->smooth);
    l->least = least_of(l->least, l->lagged);
    l->most = most_of(l->most, l->lagged);
    return l->most - l->least < l->travel;
}

/* The last check before the wire, as `Gate` has it. */
static double admissible(const hystmpc_loop *l, double wanted, int64_t at_ns) {
    const double elapsed = least_of(most_of(S(at_ns - l->gate_ns), 0.1 * l->dt_s), l->dt_s);
    const double last = least_of(most_of(l->last, l->lower), l->upper);
    const double low = most_of(l->lower, last - l->rate * elapsed), high = least_of(l->upper, last + l->rate * elapsed);
    return least_of(most_of(plain_number(wanted) ? wanted : l->last, low), high);
}

/* Why Python has to take the next sample, as far as that is known before: it then has the time until it is due. */
static int foreseen(const hystmpc_loop *l, const hystmpc_controller *c, const volatile int *asked) {
    const int64_t next = l->steps + l->skipped + 1;
    if (*asked || l->asked) return ASKED;
    if (l->written - l->read >= l->most_behind) return UNWATCHED;
    if (next + HYSTMPC_REFERENCE > l->fed || next > l->end) return UNFED;
    if (c->stopped || c->failures + 1 >= l->stop_after || 2 * l->departures >= l->departures_most) return FAILING;
    return 0;
}

/* Wait for the next sample and judge it; 0, or why Python has to take it. */
static int begin(hystmpc_loop *l, const hystmpc_controller *c, const volatile int *asked, hystmpc_sample *s, double *angle) {
    double held = (double)NAN;
    const int reason = foreseen(l, c, asked);
    if (reason) return reason;
    l->unread = 0;
    wait_until(l->deadline_ns, l->spin_ns);
    s->deadline_ns = l->deadline_ns;
    s->woke_ns = now_ns();
    s->boot_ns = boot_now_ns();
    if (s->boot_ns - l->boot_ns > l->stall_ns + l->dt_ns || s->boot_ns - l->judged_ns > l->gap_ns) return STOOD;
    if (*asked || l->asked) return ASKED;
    if (!look(l, s->woke_ns, angle, &held)) return ODD;
    if (!follows(l, held) || !moves(l, *angle, s->woke_ns)) return STRAYED;
    l->boot_ns = s->boot_ns;
    return 0;
}

static void step(hystmpc_loop *l, hystmpc_controller *c, double angle, hystmpc_sample *s) {
    double wanted[HYSTMPC_REFERENCE];
    for (int k = 0; k < HYSTMPC_REFERENCE; k++) wanted[k] = (double)NAN;
    const int64_t began_ns = now_ns();
    for (int k = 0; k < l->skipped; k++) (void)hystmpc_step(c, (double)NAN, wanted); /* nothing was sent */
    l->steps += l->skipped;
    for (int k = 0; k < HYSTMPC_REFERENCE; k++) wanted[k] = l->reference[(l->steps + 1 + k) % REFERENCES];
    if (l->late || l->skipped) hystmpc_hurry(c);
    const hystmpc_command answer = hystmpc_step(c, angle, wanted);
    l->steps++;
    s->skipped = l->skipped;
    s->angle_deg = angle;
    s->wanted = answer.u;
    s->source = answer.source;
    s->status = answer.status;
    s->missing = answer.missing;
    s->predicted_deg = answer.predicted_deg;
    s->departure_deg = answer.departure_deg;
    s->due_deg = c->due;
    s->stalled = c->estimate.stalled;
    s->failures = c->failures;
    s->model_deg = c->estimate.angles[0];
    s->forecast_error = 0.0;
    s->level = 0;
#if HYSTMPC_LEARNS
    s->model_deg -= c->learning.added[0];
    s->forecast_error = c->learning.filters.forecast_error;
#endif
#if HYSTMPC_SUPERVISED
    s->level = c->feedback.level;
#endif
    l->departures = fabs(answer.departure_deg) >= l->departure_bound ? l->departures + 1 : 0;
    s->step_ns = now_ns() - began_ns;
}

/* Send the command of a sample within the limits; what has not left counts as never sent. */
static void deliver(hystmpc_loop *l, hystmpc_sample *s) {
    s->checked_ns = now_ns();
    s->u = admissible(l, s->wanted, s->checked_ns);
    s->sent_boot_ns = boot_now_ns();
    s->sent = s->sent_boot_ns - s->boot_ns <= l->gap_ns && send_command(l, s->u);
    s->sent_ns = now_ns();
    if (!s->sent) return;
    l->last = s->u;
    l->gate_ns = s->sent_ns;
    l->judged_ns = s->boot_ns;
}

/* Take samples until one is not as expected; its reason. `asked` is set by anybody who wants the loop to end. */
int hystmpc_loop_run(hystmpc_loop *l, hystmpc_controller *c, const volatile int *asked) {
    for (;;) {
        hystmpc_sample *s = &l->samples[l->written % SAMPLES];
        double angle = (double)NAN;
        l->reason = begin(l, c, asked, s, &angle);
        if (l->reason) return l->reason;
        step(l, c, angle, s);
        deliver(l, s);
        s->readings = l->unread;
        memcpy(s->reading, l->pending, (size_t)l->unread * sizeof(hystmpc_reading));
        l->unread = 0;
        s->wall_ns = now_of(CLOCK_REALTIME);
        s->done_ns = now_ns();
        l->late = s->done_ns > l->deadline_ns + l->dt_ns;
        const int64_t behind = s->done_ns - l->deadline_ns - l->dt_ns;
        l->skipped = behind > 0 ? (int32_t)(behind / l->dt_ns) : 0;
        l->deadline_ns += (1 + (int64_t)l->skipped) * l->dt_ns;
        __atomic_store_n(&l->written, l->written + 1, __ATOMIC_RELEASE);
        if (!s->sent) return l->reason = UNSENT;
    }
}
