/* Steps of an exported controller along recorded inputs, timed one by one.
 *
 *     replay ROWS REPETITIONS < records > nanoseconds
 *
 * A record is a row of doubles: what is called, measured angles, commands, the reference. The times of all steps are
 * written as doubles, one repetition after the other. The program fails where a command differs from the recorded one. */
#define _POSIX_C_SOURCE 199309L

#include "hystmpc.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#ifdef HYSTMPC_AXES
enum { ANGLES = HYSTMPC_AXES, COMMANDS = HYSTMPC_COMMANDS };
#define GIVEN(numbers) (numbers)
#define SENT(next) (next).u
#else
enum { ANGLES = 1, COMMANDS = 1 };
#define GIVEN(numbers) (numbers)[0]
#define SENT(next) &(next).u
#endif

enum { STEP = 0, INIT = 1, STOP = 2, PREVIEW = ANGLES * HYSTMPC_REFERENCE, WIDTH = 1 + ANGLES + COMMANDS + PREVIEW };

static hystmpc_controller controller;

static double now_ns(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return 1e9 * (double)at.tv_sec + (double)at.tv_nsec;
}

static void read(const double *from, hystmpc_real *to, int count) {
    for (int k = 0; k < count; k++) to[k] = (hystmpc_real)from[k];
}

/* One step of a record [ns]; below zero where a command is another one. */
static double timed(const double *record) {
    hystmpc_real angles[ANGLES], reference[PREVIEW];
    read(record + 1, angles, ANGLES);
    read(record + 1 + ANGLES + COMMANDS, reference, PREVIEW);
    const double before = now_ns();
    const hystmpc_command next = hystmpc_step(&controller, GIVEN(angles), reference);
    const double took = now_ns() - before;
    const hystmpc_real *const sent = SENT(next);
    for (int j = 0; j < COMMANDS; j++)
        if ((double)sent[j] != record[1 + ANGLES + j]) return -1.0;
    return took;
}

/* 0, or why the controller cannot start at a record. */
static int started(const double *record) {
    hystmpc_real angles[ANGLES], commands[COMMANDS];
    read(record + 1, angles, ANGLES);
    read(record + 1 + ANGLES, commands, COMMANDS);
    return hystmpc_init(&controller, GIVEN(angles), GIVEN(commands));
}

int main(int count, char **words) {
    if (count != 3) return 1;
    const size_t rows = (size_t)atol(words[1]);
    double *records = malloc(rows * WIDTH * sizeof(double)), *times = malloc(rows * sizeof(double));
    if (!records || !times || fread(records, sizeof(double), rows * WIDTH, stdin) != rows * WIDTH) return 2;
    for (long repetition = atol(words[2]); repetition > 0; repetition--) {
        size_t steps = 0;
        for (size_t row = 0; row < rows; row++) {
            const double *record = records + row * WIDTH;
            if (record[0] == INIT) {
                if (started(record)) return 3;
            } else if (record[0] == STOP) {
                hystmpc_stop(&controller);
            } else if ((times[steps++] = timed(record)) < 0.0) {
                fprintf(stderr, "step %lu: another command\n", (unsigned long)steps);
                return 4;
            }
        }
        fwrite(times, sizeof(double), steps, stdout);
    }
    free(records);
    free(times);
    return 0;
}
