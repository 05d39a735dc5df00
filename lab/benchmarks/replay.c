/* Steps of an exported controller along recorded inputs, timed one by one.
 *
 *     replay ROWS REPETITIONS < records > nanoseconds
 *
 * A record is a row of doubles: what is called, a measurement, a command, the reference. The times of all steps are
 * written as doubles, one repetition after the other. The program fails where a command differs from the recorded one. */
#define _POSIX_C_SOURCE 199309L

#include "hystmpc.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { STEP = 0, INIT = 1, STOP = 2, WIDTH = 3 + HYSTMPC_REFERENCE };

static hystmpc_controller controller;

static double now_ns(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return 1e9 * (double)at.tv_sec + (double)at.tv_nsec;
}

/* One step of a record [ns]; below zero where its command is another one. */
static double timed(const double *record) {
    hystmpc_real reference[HYSTMPC_REFERENCE];
    for (int k = 0; k < HYSTMPC_REFERENCE; k++) reference[k] = (hystmpc_real)record[3 + k];
    const double before = now_ns();
    const hystmpc_command next = hystmpc_step(&controller, (hystmpc_real)record[1], reference);
    const double took = now_ns() - before;
    return (double)next.u == record[2] ? took : -1.0;
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
                if (hystmpc_init(&controller, (hystmpc_real)record[1], (hystmpc_real)record[2])) return 3;
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
