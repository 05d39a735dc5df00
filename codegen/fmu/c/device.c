/* A device at its sample time: state, one step, save and restore; the same for every version of the standard. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

@REFERENCES@
enum { DONE = 0, REFUSED = 2, FAILED = 3 };             /* OK, Discard and Error of the standard */
enum { MADE = 0, STARTING = 1, RUNNING = 2, ENDED = 3 }; /* what an instance has been told */
enum { MOST_SAMPLES = 10000000 };                       /* of one step: a few seconds of work */

/* The whole memory of an instance: a copy of it is a snapshot. */
typedef struct {
@SIGNALS@
    double start_s, stop_s;
    int64_t samples; /* since the start */
    int64_t stage;
} device_state;

/* Declared here, written for each version: hands a line to the importer and returns the status. */
struct instance;
static int tell(const struct instance *d, int status, const char *line);

/* A state as bytes: the token says whose it is. */
enum { TOKEN_BYTES = sizeof HYSTMPC_TOKEN, STATE_BYTES = sizeof HYSTMPC_TOKEN + sizeof(device_state) };

static int plain_number(double x) { return x - x == 0.0; }

static double device_time(const device_state *s) {
    return s->start_s + (double)s->samples * HYSTMPC_SAMPLE_S;
}

@ACCESS@
/* The start of a run. */
static int device_start(const struct instance *d, device_state *s, double start_s, double stop_s) {
    if (s->stage != MADE) return tell(d, FAILED, "the start time can be set only before the initialisation");
    if (!(fabs(start_s + HYSTMPC_SAMPLE_S - start_s - HYSTMPC_SAMPLE_S) <= 1e-3 * HYSTMPC_SAMPLE_S))
        return tell(d, FAILED, "the start time is no number, or too large to count samples from");
    if (!(stop_s >= start_s)) return tell(d, FAILED, "the stop time is no number, or before the start");
    s->start_s = start_s;
    s->stop_s = stop_s;
    return DONE;
}

/* From one stage of a run to the next. */
static int device_enter(const struct instance *d, device_state *s, int from, int to) {
    if (s->stage != from) return tell(d, FAILED, "called out of order: instantiate, initialise, step, terminate");
    s->stage = to;
    return DONE;
}

@ADVANCE@
/* Whole samples; the state is kept where the step is refused or fails. */
static int device_step(const struct instance *d, device_state *s, double at_s, double length_s) {
    char line[200];
    const double samples = length_s / HYSTMPC_SAMPLE_S, whole = floor(samples + 0.5), now_s = device_time(s);
    const device_state before = *s;
    if (s->stage != RUNNING) return tell(d, FAILED, "step: the instance is not initialised, or is terminated");
    if (!(whole >= 1.0 && fabs(samples - whole) <= 1e-6)) {
        snprintf(line, sizeof line, "step: got %.9g s, expected a whole multiple of the sample time %.9g s", length_s,
                 HYSTMPC_SAMPLE_S);
        return tell(d, length_s > 0.0 && plain_number(length_s) ? REFUSED : FAILED, line);
    }
    if (!(whole <= (double)MOST_SAMPLES && s->samples >= 0 && s->samples <= INT64_MAX - MOST_SAMPLES)) {
        snprintf(line, sizeof line, "step: got %.9g s, expected at most %d samples of %.9g s", length_s, MOST_SAMPLES,
                 HYSTMPC_SAMPLE_S);
        return tell(d, FAILED, line);
    }
    if (!(fabs(at_s - now_s) <= 0.5 * HYSTMPC_SAMPLE_S)) {
        snprintf(line, sizeof line, "step: got time %.9g s, expected %.9g s, where the last step ended", at_s, now_s);
        return tell(d, FAILED, line);
    }
    if (now_s + length_s > s->stop_s + 0.5 * HYSTMPC_SAMPLE_S) {
        snprintf(line, sizeof line, "step: got an end at %.9g s, beyond the stop time %.9g s", now_s + length_s,
                 s->stop_s);
        return tell(d, FAILED, line);
    }
    for (int k = 0; k < (int)whole; k++) {
        if (device_advance(s)) continue;
        *s = before;
        return tell(d, FAILED, "step: the device does not answer this command with finite numbers");
    }
    return DONE;
}

/* A copy of the state, in the place of an older copy where there is one. */
static int device_save(const struct instance *d, const device_state *s, void **copy) {
    if (!*copy) *copy = malloc(sizeof *s);
    if (!*copy) return tell(d, FAILED, "save: no memory");
    memcpy(*copy, s, sizeof *s);
    return DONE;
}

static int device_restore(const struct instance *d, device_state *s, const void *copy) {
    if (!copy) return tell(d, FAILED, "restore: no state");
    memcpy(s, copy, sizeof *s);
    return DONE;
}

static int device_pack(const struct instance *d, const void *copy, void *bytes, size_t count) {
    if (!copy || count < STATE_BYTES) return tell(d, FAILED, "serialise: no state, or too few bytes for it");
    memcpy(bytes, HYSTMPC_TOKEN, TOKEN_BYTES);
    memcpy((char *)bytes + TOKEN_BYTES, copy, sizeof(device_state));
    return DONE;
}

static int device_unpack(const struct instance *d, const void *bytes, size_t count, void **copy) {
    if (count < STATE_BYTES || memcmp(bytes, HYSTMPC_TOKEN, TOKEN_BYTES) != 0)
        return tell(d, FAILED, "deserialise: these are not the bytes of a state of this FMU");
    return device_save(d, (const void *)((const char *)bytes + TOKEN_BYTES), copy);
}
