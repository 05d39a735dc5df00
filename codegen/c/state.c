/* The model with its learned part: predictions, one-step inverse, the inverse followed along a preview. */
#include "internal.h"

static int state_acts(const hystmpc_state *s) {
#if HYSTMPC_LEARNS
    return s->acts;
#else
    (void)s;
    return 0;
#endif
}

#if HYSTMPC_LEARNS
static void add_learned(const hystmpc_state *s, const real *commands, int samples, real *angles) {
    hystmpc_add_learned(&hystmpc_learns.basis, &s->learned, commands, samples, angles);
}
#endif

/* Angles along a plan. */
HYSTMPC_LOCAL void state_run(const hystmpc_state *s, const real *commands, real *angles) {
    run_model(s->model, commands, H, angles);
#if HYSTMPC_LEARNS
    if (s->acts) add_learned(s, commands, H, angles);
#endif
}

/* Angles along some plans, no more than there are candidates. */
HYSTMPC_LOCAL void state_run_plans(hystmpc_work *w, const hystmpc_state *s, real (*plans)[HYSTMPC_HORIZON], int count,
                                   real (*angles)[HYSTMPC_HORIZON]) {
    run_plans(w, s->model, plans, count, angles);
#if HYSTMPC_LEARNS
    if (!s->acts) return;
    for (int n = 0; n < count; n++) add_learned(s, plans[n], H, angles[n]);
#endif
}

/* The Jacobian along a plan, in the work space. */
HYSTMPC_LOCAL void state_linearise(hystmpc_work *w, const hystmpc_state *s, const real *commands) {
    linearise_model(w, s->model, commands);
#if HYSTMPC_LEARNS
    if (s->acts)
        hystmpc_add_slopes(&hystmpc_learns.basis, &s->learned, commands, H, w->jacobian[0], w->moving[0][0]);
#endif
}

/* What the learned part adds along a plan, by the model's angles. */
static void learned_along(const hystmpc_state *s, const real *commands, int samples, real *added) {
#if HYSTMPC_LEARNS
    real alone[HYSTMPC_HORIZON];
    run_model(s->model, commands, samples, alone);
    copy(alone, added, samples);
    add_learned(s, commands, samples, added);
    for (int k = 0; k < samples; k++) added[k] -= alone[k];
#else
    (void)s;
    (void)commands;
    fill(added, R(0.0), samples);
#endif
}

/* The command at which the device comes to rest at the angle, from its present memory. */
HYSTMPC_LOCAL real state_inverse(const hystmpc_state *s, real theta, real u_last) {
    real added = R(0.0);
    if (state_acts(s)) learned_along(s, &u_last, 1, &added);
    return middle_command(s->model + HYSTMPC_FRONT, theta - added, u_last);
}

#if HYSTMPC_FRONT || HYSTMPC_BACK

/* Dynamics behind are undone along the preview, the inverse follows what is left from the instant on at which a command
 * acts, and the drive is led along its answer within the rate limit. Both plans are the same. */
static void follow(hystmpc_work *w, const real *x, const real *wanted, real u_last, real *boxed, real *limited) {
    real travel[HYSTMPC_HORIZON], middle[HYSTMPC_STATES], last = u_last;
    int first = 0;
    copy(wanted, travel, H);
#if HYSTMPC_BACK
    real behind[HYSTMPC_HORIZON];
    fit_drive(w, &hystmpc_back, x + S - HYSTMPC_BACK, wanted, wanted[0], INFINITE, behind);
    wanted = behind;
    copy(wanted, travel, H);
#endif
    copy(x + HYSTMPC_FRONT, middle, S - HYSTMPC_FRONT - HYSTMPC_BACK);
#if HYSTMPC_FRONT
    real held[HYSTMPC_HORIZON];
    fill(held, u_last, H);
    linearise_plan(w, &hystmpc_front, x, held, travel);
    first = first_acting(w);
    for (int k = 0; k < first; k++) {
        middle_step(middle, travel[k]);
        last = travel[k];
    }
#endif
    if (first >= H) {
        fill(boxed, u_last, H);
        fill(limited, u_last, H);
        return;
    }
    for (int k = first; k < H; k++) {
        const real u = middle_command(middle, wanted[k], last);
        last = clamp(is_finite(u) ? u : last, HYSTMPC_LOWER, HYSTMPC_UPPER);
        travel[k] = last;
        middle_step(middle, last);
    }
    copy(travel, boxed, H);
#if HYSTMPC_FRONT
    fit_drive(w, &hystmpc_front, x, travel, u_last, HYSTMPC_REACH, boxed);
#endif
    for (int k = 0; k < H; k++) limited[k] = boxed[k] = clamp(boxed[k], HYSTMPC_LOWER, HYSTMPC_UPPER);
}

#else

/* The inverse sample by sample: within the box alone, and within the rate limit too. */
static void follow(hystmpc_work *w, const real *x, const real *wanted, real u_last, real *boxed, real *limited) {
    real now[2][HYSTMPC_STATES], last[2], u[2] = {R(0.0), R(0.0)};
    int rows = 1;
    (void)w;
    copy(x, now[0], S);
    last[0] = last[1] = u_last;
    for (int k = 0; k < H; k++) {
        for (int row = 0; row < rows; row++) {
            const real goal = middle_command(now[row], wanted[k], last[row]);
            u[row] = clamp(is_finite(goal) ? goal : last[row], HYSTMPC_LOWER, HYSTMPC_UPPER);
        }
        if (rows == 1 && absolute(u[0] - last[0]) > HYSTMPC_REACH) {
            rows = 2;
            copy(now[0], now[1], S);
            last[1] = last[0];
            u[1] = u[0];
        }
        if (rows == 2) u[1] = clamp(u[1], last[1] - HYSTMPC_REACH, last[1] + HYSTMPC_REACH);
        for (int row = 0; row < rows; row++) {
            last[row] = u[row];
            middle_step(now[row], u[row]);
        }
        boxed[k] = u[0];
        limited[k] = u[rows - 1];
    }
}

#endif

/* Commands along the wanted angles. With a learned part: at the angles less what it adds, first as in a hold, then as
 * along the plan found, a fixed point where the learned part is the smaller one. */
HYSTMPC_LOCAL void state_follow(hystmpc_work *w, const hystmpc_state *s, const real *wanted, real u_last, real *boxed,
                                real *limited) {
    real along[HYSTMPC_HORIZON], added[HYSTMPC_HORIZON];
    if (!state_acts(s)) {
        follow(w, s->model, wanted, u_last, boxed, limited);
        return;
    }
    fill(limited, u_last, H);
    for (int round = 0; round < 3; round++) {
        learned_along(s, limited, H, added);
        for (int k = 0; k < H; k++) along[k] = wanted[k] - added[k];
        follow(w, s->model, along, u_last, boxed, limited);
    }
}

#if HYSTMPC_SUPERVISED
/* One sample later under the command u. */
HYSTMPC_LOCAL void state_advance(hystmpc_state *s, real u) {
    real angle, next[HYSTMPC_STATES];
    model_step(s->model, u, &angle, next);
    copy(next, s->model, S);
#if HYSTMPC_LEARNS
    hystmpc_learned_advance(&hystmpc_learns.basis, &s->learned, u);
#endif
}
#endif
