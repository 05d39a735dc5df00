/* A program with an FMU 3.0 linked into it: steps, states, refusals, two instances; run under sanitizers. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define FMI3_FUNCTION_PREFIX device_
#include "fmi3Functions.h"

static int lines;
static void count(fmi3InstanceEnvironment at, fmi3Status status, fmi3String category, fmi3String text) {
    (void)at, (void)status, (void)category, (void)text;
    lines++;
}

static double run(fmi3Instance device, double start_s, int steps) {
    const fmi3ValueReference angle = 1 + COMMANDS;
    double value = 0.0, reached_s = start_s;
    fmi3Boolean event, ends, early;
    for (int k = 0; k < steps; k++) {
        value = 6.0 * (double)((k * 37) % 101) / 100.0;
        for (fmi3ValueReference command = 1; command <= COMMANDS; command++)
            fmi3SetFloat64(device, &command, 1, &value, 1);
        fmi3DoStep(device, reached_s, SAMPLE_S, fmi3True, &event, &ends, &early, &reached_s);
    }
    fmi3GetFloat64(device, &angle, 1, &value, 1);
    return value;
}

int main(void) {
    fmi3Boolean flag;
    double time_s;
    size_t size = 0;
    fmi3FMUState saved = NULL, unpacked = NULL;
    fmi3Instance one = fmi3InstantiateCoSimulation("one", TOKEN, NULL, false, false, false, false, NULL, 0, NULL, count, NULL);
    fmi3Instance two = fmi3InstantiateCoSimulation("two", TOKEN, NULL, false, false, false, false, NULL, 0, NULL, count, NULL);
    if (fmi3InstantiateCoSimulation("no", "other", NULL, false, false, false, false, NULL, 0, NULL, count, NULL)) return 1;
    if (fmi3InstantiateModelExchange("no", TOKEN, NULL, false, false, NULL, count)) return 2;
    fmi3EnterInitializationMode(one, false, 0.0, 0.0, false, 0.0);
    fmi3ExitInitializationMode(one);
    fmi3EnterInitializationMode(two, false, 0.0, 0.0, false, 0.0);
    fmi3ExitInitializationMode(two);
    run(one, 0.0, 1500);
    fmi3GetFMUState(one, &saved);
    fmi3GetFMUState(one, &saved); /* in the place of the first */
    const double once = run(one, 1500 * SAMPLE_S, 1500);
    fmi3SerializedFMUStateSize(one, saved, &size);
    fmi3Byte *bytes = malloc(size);
    fmi3SerializeFMUState(one, saved, bytes, size);
    fmi3DeserializeFMUState(two, bytes, size, &unpacked);
    fmi3SetFMUState(two, unpacked);
    if (run(two, 1500 * SAMPLE_S, 1500) != once) return 3;
    if (fmi3DoStep(one, 3000 * SAMPLE_S, 0.3 * SAMPLE_S, true, &flag, &flag, &flag, &time_s) != fmi3Discard) return 4;
    if (fmi3DeserializeFMUState(two, bytes, size - 1, &unpacked) != fmi3Error) return 5;
    fmi3FreeFMUState(one, &saved);
    fmi3FreeFMUState(two, &unpacked);
    free(bytes);
    fmi3Terminate(one);
    fmi3FreeInstance(one);
    fmi3FreeInstance(two);
    printf("%d refusals\n", lines);
    return 0;
}
