/* Samples of a run in C: wait, read, judge, step, limit, send, write down.
 *
 * A sample is taken here only while all is as expected. The first that is not is left to the Python loop, undecided:
 * with what it has read, and before anything is sent. So the rules of what to do in a fault stand in Python alone; here
 * stands when they may be needed. Python looks at every sample that was taken here within some samples, by its own
 * rules, and where it does not keep up the loop ends, too.
 *
 * For systems with POSIX sockets and clocks, in double precision; no part of an exported controller. */
#ifndef HYSTMPC_LOOP_H
#define HYSTMPC_LOOP_H

#include "controller.h"

enum {
    HYSTMPC_READINGS = 4,      /* of a sample, at most */
    HYSTMPC_SAMPLES = 256,     /* that are written down until Python has read them */
    HYSTMPC_REFERENCES = 4096, /* known samples of the reference, the preview of a step included */
    HYSTMPC_RECENT = 128       /* commands sent lately, with which the drive's report is compared */
};

/* Why the loop has ended: the sample at `deadline_ns` is to be taken by Python. */
enum {
    HYSTMPC_LOOP_ASKED = 1,     /* a stop, an end or another target */
    HYSTMPC_LOOP_STOOD = 2,     /* the process has stood still */
    HYSTMPC_LOOP_UNWATCHED = 3, /* Python does not keep up */
    HYSTMPC_LOOP_UNFED = 4,     /* the reference is not known far enough, or at its end */
    HYSTMPC_LOOP_ODD = 5,       /* a reading that is not as expected, or none for too long */
    HYSTMPC_LOOP_STRAYED = 6,   /* what the device holds, or how it moves, may be a fault */
    HYSTMPC_LOOP_FAILING = 7,   /* the controller is about to stop, or its model is off */
    HYSTMPC_LOOP_UNSENT = 8,    /* a command has not left */
    HYSTMPC_LOOP_ABSENT = 9     /* this system has no such loop */
};

typedef struct {
    int64_t received_ns;
    int32_t size; /* of the datagram, 48 where it is longer */
    uint8_t data[48];
} hystmpc_reading;

/* What a sample was. */
typedef struct {
    int64_t deadline_ns, woke_ns, boot_ns, checked_ns, sent_boot_ns, sent_ns, done_ns, wall_ns, step_ns;
    hystmpc_command answer; /* of the controller */
    double u;               /* its command within the limits of the last check */
    double angle_deg, model_deg, due_deg, forecast_error; /* model_deg: without what is learned */
    int32_t stalled, level, failures;
    int32_t sent;    /* whether the command has left */
    int32_t skipped; /* whole samples that had passed before it */
    int32_t readings;
    hystmpc_reading reading[HYSTMPC_READINGS];
} hystmpc_sample;

typedef struct {
    /* What Python sets before the loop begins. */
    int64_t dt_ns, spin_ns, stall_ns, gap_ns;
    double dt_s, lower, upper, rate;                   /* last check before the wire */
    double angle_factor, angle_offset, command_factor; /* of the wire's units */
    double angle_low, angle_high, angle_rate, age_limit_s, tolerance, frozen_travel; /* sensor; tolerance < 0: none */
    double travel, lag_s, moves, smooth_s;             /* motion watch; travel < 0: none */
    double departure_bound;
    int32_t descriptor, frozen_samples, recent_most, stop_after, departures_most, most_behind;
    uint32_t session, own_session;
    /* What changes; Python sets how it begins, and finds how it ended. */
    int64_t deadline_ns, boot_ns, accepted_ns, rated_ns, heard_ns, gate_ns, judged_ns, watched_ns;
    double flight_ns, angle, rated, travelled, command; /* of the intake */
    double last;                                        /* of the gate: sent last */
    double smooth, lagged, low, high, least, most;      /* of the motion watch */
    double recent[HYSTMPC_RECENT];                      /* commands sent lately */
    int64_t steps;                                      /* of the controller's clock */
    int64_t end;                                        /* steps after which the reference is over */
    int32_t repeats, recent_count, recent_next, departures, late, skipped, unread, reason;
    uint32_t sequence, sent_sequence;
    hystmpc_reading pending[HYSTMPC_READINGS];          /* read, not decided */
    /* Between the two, each written by one side alone. */
    volatile int64_t written, read;                     /* samples */
    volatile int64_t fed;                               /* reference samples that are known */
    volatile int32_t asked;                             /* whether to end: what is tracked has changed */
    double reference[HYSTMPC_REFERENCES];               /* by number of the sample, around the end */
    hystmpc_sample samples[HYSTMPC_SAMPLES];
} hystmpc_loop;

/* Room for a run with this controller. */
HYSTMPC_API long hystmpc_loop_room_bytes(const void *problem);

/* Take samples with a controller's memory until one is not as expected; its reason. `asked`: an int, not zero once
 * anybody wants the loop to end. */
HYSTMPC_API int hystmpc_loop_run(void *loop, const void *problem, char *memory, char *room, const void *asked);

/* How many samples are written down, whole. */
HYSTMPC_API long hystmpc_loop_written(const void *loop);

#endif
