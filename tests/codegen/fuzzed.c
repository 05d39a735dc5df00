/* Every public function in a random order with odd numbers, on started, refused, zeroed and foreign memory. Each command
 * is finite and within the limits on value, and on rate from the last one sent; what is remembered stays finite. */
#include "hystmpc.c" /* not its header alone: what is remembered is looked at */

#include "fuzzing.h"

#define MOVE ((real)REACH * (real)(1.0 + (HYSTMPC_SINGLE ? 1e-4 : 1e-12))) /* in a sample at most */

#define LOW ((real)HYSTMPC_LOWEST)
#define HIGH ((real)HYSTMPC_HIGHEST)

static hystmpc_controller controller;

static int stopped(void) {
    hystmpc_memory m;
    hystmpc_memory_at(&exported_problem, memory_of(&controller), &m);
    return m.head->stopped;
}

static int admissible(real u) { return LOW <= u && u <= HIGH; }
static real nearest(real u) { return u < LOW ? LOW : u > HIGH ? HIGH : u; }

/* On memory that no init has accepted; it holds `held`, or any admissible command where that is not-a-number. */
static int stands_still(hystmpc_controller *c, real held) {
    real reference[HYSTMPC_REFERENCE];
    for (int k = 0; k < HYSTMPC_REFERENCE; k++) reference[k] = any(30, 80);
    for (int k = 0; k < 8; k++) {
        if (below(2)) hystmpc_stop(c);
        if (below(2)) hystmpc_hurry(c);
        if (below(2)) hystmpc_set_target(c, any(30, 80));
        if (below(2) && hystmpc_measure(c, any(30, 80), any(0, 5))) return 0;
        if (below(2) && hystmpc_look_on(c, any(30, 80), any(LOW, HIGH)) == 0) return 0;
        const hystmpc_command next = hystmpc_step(c, any(30, 80), below(2) ? reference : NULL);
        if (next.source != HYSTMPC_STOP || next.status != HYSTMPC_LATCHED || !admissible(next.u)) return 0;
        if (held == held && next.u != held) return 0;
        held = next.u;
    }
    return 1;
}

/* Memory of every kind before anything has been started. */
static int unstarted(void) {
    const real odd[] = {(real)NAN, (real)INFINITY, (real)1e30, -(real)1e30, LOW, HIGH};
    for (int byte = 0; byte <= 0xFF; byte += 0x55) {
        memset(&controller, byte, sizeof controller);
        if (!stands_still(&controller, (real)NAN)) return 0;
        for (unsigned i = 0; i < sizeof odd / sizeof odd[0]; i++) {
            memset(&controller, byte, sizeof controller);
            const real held = isfinite(odd[i]) ? nearest(odd[i]) : LOW;
            if (hystmpc_init(&controller, (real)NAN, odd[i]) != HYSTMPC_BAD_ANGLE) return 0;
            if (!stands_still(&controller, held)) return 0;
        }
    }
    return 1;
}

int main(int count, char **words) {
    real reference[HYSTMPC_REFERENCE], last = 2, angle = 45, walked = 0;
    int started_again = 0;
    if (count > 1) sscanf(words[1], "%llu", &state);
    if (!unstarted()) return 1;
    memset(&controller, 0, sizeof controller);
    if (hystmpc_init(&controller, angle, last) != HYSTMPC_STARTED) return 2;
    for (int k = 0; k < STEPS; k++) {
        const int walking = k / 700 % 4 == 3; /* a sensor that walks away, however far */
        const unsigned what = walking ? 1000 : below(1000);
        const real target = k / 150 % 3 ? between(20, 90) : 55;
        if (what < 4) {
            hystmpc_stop(&controller);
        } else if (what < 30) {
            hystmpc_hurry(&controller);
        } else if (what < 60) {
            hystmpc_set_target(&controller, any(20, 90));
        } else if (what < 100) {
            const real sent = any(LOW, HIGH);
            if (hystmpc_look_on(&controller, below(3) ? angle : any(0, 120), sent)) return 3;
            if (isfinite(sent)) last = nearest(sent);
        } else if (what < 110) {
            const real age = between(-1, 30);
            const int used = hystmpc_measure(&controller, below(3) ? angle : any(0, 120), any(0, 1) + age);
            if (used && exported_problem.sensing->sensor != HYSTMPC_FRAMES) return 9;
        } else if (what < 120) {
            const real held = below(3) ? any(LOW, HIGH) : last;
            const int refused = hystmpc_init(&controller, below(3) ? angle : any(0, 120), held);
            if (!refused) last = held;
            if (!refused != !stopped()) return 4;
            started_again += !refused;
        }
        if (stopped() && below(60) == 0 && !hystmpc_init(&controller, angle, last)) started_again++;
        angle += (real)0.4 * ((real)(28.0 + 10.0 * (double)last) - angle);
        for (int j = 0; j < HYSTMPC_REFERENCE; j++) reference[j] = target;
        if (below(50) == 0) reference[below(HYSTMPC_REFERENCE)] = any(20, 90);
        walked = walking ? walked + 12 : 0;
        const real measured = walking || below(12) ? angle + walked + between(-1, 1) / 5 : any(-200, 200);
        const hystmpc_command next = hystmpc_step(&controller, measured, below(5) ? reference : NULL);
        if (!admissible(next.u) || !(next.u <= last + MOVE && next.u >= last - MOVE)) return 5;
        if (!isfinite(next.departure_deg) || !isfinite(next.predicted_deg) != !exported_problem.model) return 6;
        if (!memory_finite(&exported_problem, memory_of(&controller))) return 7;
        if (stopped() != (next.source == HYSTMPC_STOP)) return 8;
        last = next.u;
    }
    printf("%d steps\n", started_again > 5 ? STEPS : 0);
    return 0;
}
