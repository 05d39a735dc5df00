/* Every public function of a controller of two axes in a random order with odd numbers, on started, refused, zeroed and
 * foreign memory. All commands are finite and within the limits on value, and on rate from the last ones sent; what is
 * remembered stays finite. */
#include "hystmpc.c" /* not its header alone: what is remembered is looked at */

#include "fuzzing.h"

#include <stdlib.h>

#define N HYSTMPC_COMMANDS

static hystmpc_controller controller;
static const real lowest[N] = HYSTMPC_LOWEST, highest[N] = HYSTMPC_HIGHEST;

static real nearest(real u, int j) { return clamp(u, lowest[j], highest[j]); }

/* Angles of the tip, mostly as they should be. */
static const real *angles(real low, real high) {
    static real made[HYSTMPC_AXES];
    for (int i = 0; i < HYSTMPC_AXES; i++) made[i] = any(low, high);
    return made;
}

static const real *commands(void) {
    static real made[N];
    for (int j = 0; j < N; j++) made[j] = any(lowest[j], highest[j]);
    return made;
}

/* Whether commands are admissible, at most `share` of a greatest move behind others where those are known. */
static int admissible(const real *u, const real *last, real share) {
    for (int j = 0; j < N; j++) {
        const real reach = exported_problem.reach[j] * (share + (HYSTMPC_SINGLE ? R(1e-4) : R(1e-12)));
        if (!(lowest[j] <= u[j] && u[j] <= highest[j])) return 0;
        if (last && !(u[j] <= last[j] + reach && u[j] >= last[j] - reach)) return 0;
    }
    return 1;
}

static int state_finite(void) {
    axes_call c;
    axes_open(&exported_problem, memory_of(&controller), &c);
    int finite = finite_all(c.last, N);
    if (exported_problem.cross)
        finite = finite && finite_all(c.past, HYSTMPC_AXES * HYSTMPC_PAST) &&
                 finite_all(c.cross, hystmpc_cross_states(exported_problem.cross));
    for (int i = 0; i < HYSTMPC_AXES; i++) finite = finite && memory_finite(c.axis[i].p, c.axis[i].memory);
    return finite;
}

static int stopped(void) {
    axes_call c;
    axes_open(&exported_problem, memory_of(&controller), &c);
    return c.axis[0].m.head->stopped || c.axis[1].m.head->stopped;
}

/* On memory that no init has accepted; it holds `held`, or any admissible commands where that is null. */
static int stands_still(hystmpc_controller *c, const real *held) {
    real reference[HYSTMPC_REFERENCE * HYSTMPC_AXES], last[N];
    for (int k = 0; k < HYSTMPC_REFERENCE * HYSTMPC_AXES; k++) reference[k] = any(-20, 20);
    for (int k = 0; k < 6; k++) {
        if (below(2)) hystmpc_stop(c);
        if (below(2)) hystmpc_hurry(c);
        if (below(2)) hystmpc_set_target(c, angles(-20, 20));
        if (below(2) && hystmpc_measure(c, angles(-20, 20), any(0, 5))) return 0;
        if (below(2) && hystmpc_look_on(c, angles(-20, 20), commands()) == 0) return 0;
        const hystmpc_command next = hystmpc_step(c, angles(-20, 20), below(2) ? reference : NULL);
        if (next.source != HYSTMPC_STOP || !admissible(next.u, k || held ? (k ? last : held) : NULL, R(0.0))) return 0;
        for (int i = 0; i < HYSTMPC_AXES; i++)
            if (next.status[i] != HYSTMPC_LATCHED) return 0;
        copy(next.u, last, N);
    }
    return 1;
}

/* Memory of every kind before anything has been started. */
static int unstarted(void) {
    const real odd[] = {(real)NAN, (real)INFINITY, R(1e30), -R(1e30), lowest[0], highest[0]};
    const real nothing[HYSTMPC_AXES] = {R(0.0), (real)NAN};
    for (int byte = 0; byte <= 0xFF; byte += 0x55) {
        memset(&controller, byte, sizeof controller);
        if (!stands_still(&controller, NULL)) return 0;
        for (unsigned i = 0; i < sizeof odd / sizeof odd[0]; i++) {
            real given[N], held[N];
            memset(&controller, byte, sizeof controller);
            for (int j = 0; j < N; j++) given[j] = odd[i], held[j] = nearest(isfinite(odd[i]) ? odd[i] : exported_problem.rest[j], j);
            if (hystmpc_init(&controller, nothing, given) != HYSTMPC_BAD_ANGLE) return 0;
            if (!stands_still(&controller, held)) return 0;
        }
    }
    return 1;
}

/* One call that is no step; below zero where it breaks a law. `last`: commands sent last. */
static int call(unsigned what, const real *seen, real *last) {
    if (what < 4) hystmpc_stop(&controller);
    else if (what < 30) hystmpc_hurry(&controller);
    else if (what < 60) hystmpc_set_target(&controller, angles(-20, 20));
    else if (what < 100) {
        const real *const sent = commands();
        if (hystmpc_look_on(&controller, below(3) ? seen : angles(-60, 60), sent)) return -3;
        for (int j = 0; j < N; j++)
            if (isfinite(sent[j])) last[j] = nearest(sent[j], j);
    } else if (what < 110) {
        const int used = hystmpc_measure(&controller, below(3) ? seen : angles(-60, 60), any(0, 1) + between(-1, 30));
        const int sensor = exported_problem.first->sensing->sensor;
        if (used && sensor != HYSTMPC_FRAMES && sensor != HYSTMPC_NEWEST_FRAME) return -9;
    } else if (what < 150) {
        real held[N];
        copy(below(3) ? commands() : last, held, N);
        const int refused = hystmpc_init(&controller, below(3) ? angles(-60, 60) : seen, held);
        if (!refused) copy(held, last, N);
        if (!refused != !stopped()) return -4;
        return !refused;
    }
    return 0;
}

int main(int count, char **words) {
    real reference[HYSTMPC_REFERENCE * HYSTMPC_AXES], last[N], y[HYSTMPC_AXES] = {0, 0}, walked = 0;
    int started_again = 0;
    const real share = count > 1 ? (real)atof(words[1]) : R(1.0); /* of the greatest move that is allowed */
    if (!unstarted()) return 1;
    memset(&controller, 0, sizeof controller);
    copy(exported_problem.rest, last, N);
    if (hystmpc_init(&controller, y, last) != HYSTMPC_STARTED) return 2;
    for (int k = 0; k < STEPS; k++) {
        const int walking = k / 100 % 4 == 3; /* sensors that walk away, however far */
        real seen[HYSTMPC_AXES], measured[HYSTMPC_AXES], w[HYSTMPC_AXES];
        axes_travels(&exported_problem, last, 1, w, 1);
        for (int i = 0; i < HYSTMPC_AXES; i++) y[i] += R(0.4) * (R(8.0) * w[i] - y[i]);
        axes_map(exported_problem.frame, HYSTMPC_AXES, HYSTMPC_AXES, y, 1, seen, 1);
        const int answer = call(walking ? 1000 : below(1000), seen, last);
        if (answer < 0) return -answer;
        started_again += answer;
        if (stopped() && below(60) == 0 && !hystmpc_init(&controller, seen, last)) started_again++;
        for (int j = 0; j < HYSTMPC_REFERENCE * HYSTMPC_AXES; j++) reference[j] = k / 150 % 3 ? between(-30, 30) : R(5.0);
        if (below(50) == 0) reference[below(HYSTMPC_REFERENCE * HYSTMPC_AXES)] = any(-20, 20);
        walked = walking ? walked + 12 : 0;
        for (int i = 0; i < HYSTMPC_AXES; i++)
            measured[i] = walking || below(12) ? seen[i] + walked + between(-1, 1) / 5 : any(-200, 200);
        const hystmpc_command next = hystmpc_step(&controller, measured, below(5) ? reference : NULL);
        if (!admissible(next.u, last, share)) return 5;
        for (int i = 0; i < HYSTMPC_AXES; i++)
            if (!isfinite(next.departure_deg[i]) || !isfinite(next.predicted_deg[i]) != !exported_problem.first->model) return 6;
        if (!state_finite()) return 7;
        if (stopped() != (next.source == HYSTMPC_STOP)) return 8;
        copy(next.u, last, N);
    }
    printf("%d steps\n", started_again > 5 ? STEPS : 0);
    return 0;
}
