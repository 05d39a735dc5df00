/* Steps with noise, missing and absurd measurements, bad references and stops. */
#include "hystmpc.h"

#include <math.h>
#include <stdio.h>

#ifndef STEPS
#define STEPS 3000
#endif

static hystmpc_controller controller;

int main(void) {
    unsigned state = 1u;
    hystmpc_real last = 2.0, angle = 45.0;
    hystmpc_real reference[HYSTMPC_REFERENCE];
    if (hystmpc_init(&controller, angle, last) != HYSTMPC_STARTED) return 1;
    for (int k = 0; k < STEPS; k++) {
        state = state * 1664525u + 1013904223u;
        const hystmpc_real noise = (hystmpc_real)(state >> 8) / 16777216.0 - 0.5;
        hystmpc_real measured = angle + noise;
        if (k % 97 > 90) measured = (hystmpc_real)NAN;
        if (k % 211 > 207) measured = k % 2 ? 1e300 : -(hystmpc_real)INFINITY;
        for (int j = 0; j < HYSTMPC_REFERENCE; j++) reference[j] = 50.0 + 20.0 * sin(0.05 * (k / 100 % 2 ? k + j : 0));
        if (k % 301 == 300) reference[1] = (hystmpc_real)NAN;
        if (k % 150 == 149) hystmpc_stop(&controller);
        if (k % 150 == 20 && hystmpc_init(&controller, angle, last) != HYSTMPC_STARTED) return 2;
        const hystmpc_command next = hystmpc_step(&controller, measured, k % 5 == 4 ? NULL : reference);
        if (!(next.u >= HYSTMPC_LOWEST && next.u <= HYSTMPC_HIGHEST)) return 3;
        angle += 0.4 * (28.0 + 10.0 * next.u - angle);
        last = next.u;
    }
    printf("%d steps\n", STEPS);
    return 0;
}
