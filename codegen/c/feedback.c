/* Supervisory switching: predictive control where the model predicts what is measured, else feedback. */
#include "internal.h"

/* The nearest admissible command; the last one where u is no number. */
HYSTMPC_LOCAL real within_limits(real u, real last) {
    const real at = clamp(last, HYSTMPC_LOWER, HYSTMPC_UPPER);
    return clamp(is_finite(u) ? u : last, most(HYSTMPC_LOWER, at - HYSTMPC_REACH), least(HYSTMPC_UPPER, at + HYSTMPC_REACH));
}

#if HYSTMPC_SUPERVISED

enum { PREDICTIVE = 0, INVERSE_PID = 1, PID_ALONE = 2 };

static const real thresholds[2] = {HYSTMPC_INVERSE_PID_ABOVE, HYSTMPC_PID_ABOVE};

HYSTMPC_LOCAL void init_supervisor(hystmpc_controller *c) { c->feedback.level = PREDICTIVE; }

/* kp e + I - kd dy/dt on top of a feedforward, with I' = ki e + (u_limited - u) / tracking; the slope is that between two
 * measurements. */
static real correct_pid(hystmpc_feedback *f, real error, const given *g, real feedforward) {
    const int fresh = g->age < f->age + R(1.0);
    real age = f->age + R(1.0);
    if (fresh) {
        const real elapsed = HYSTMPC_DT_S * most(age - g->age, R(1.0));
        f->speed += elapsed / (HYSTMPC_PID_FILTER_S + elapsed) * ((g->measured - f->angle) / elapsed - f->speed);
    }
    const real u = feedforward + HYSTMPC_PID_KP * error + f->integral - HYSTMPC_PID_KD * f->speed;
    const real excess = within_limits(u, g->u_last) - u;
    const real integrated = absolute(error) > HYSTMPC_PID_DEAD_ZONE ? error : R(0.0);
    const real integral =
        f->integral + HYSTMPC_DT_S * (HYSTMPC_PID_KI * integrated + excess / HYSTMPC_PID_TRACKING_S);
    f->integral = clamp(integral, HYSTMPC_LOWER - HYSTMPC_UPPER, HYSTMPC_UPPER - HYSTMPC_LOWER);
    f->angle = fresh ? g->measured : f->angle;
    f->age = fresh ? g->age : age;
    return u;
}

/* The memory with which the next command is the last one sent. */
static void take_over_pid(hystmpc_feedback *f, real error, const given *g, real feedforward) {
    f->integral = g->u_last - feedforward - HYSTMPC_PID_KP * error;
    f->speed = R(0.0);
    f->angle = g->measured;
    f->age = g->age;
}

/* The inverse of the angle followed: changes of the reference within the dead zone are not. */
static real feedforward_command(const hystmpc_state *s, real *followed, real wanted, real u_last) {
    if (absolute(wanted - *followed) >= HYSTMPC_REFERENCE_DEAD_ZONE) *followed = wanted;
    return state_inverse(s, *followed, u_last);
}

static void take_over(hystmpc_controller *c, const given *g, int level) {
    hystmpc_feedback *f = &c->feedback;
    f->level = level;
    if (level == PREDICTIVE) {
        init_predictive(c);
    } else if (level == PID_ALONE) {
        take_over_pid(f, g->setpoint - g->measured, g, HYSTMPC_LOWER);
    } else {
        real followed = f->followed = g->due;
        const real alone = feedforward_command(&g->state, &followed, g->reference[0], g->u_last);
        take_over_pid(f, g->due - g->measured, g, within_limits(alone, g->u_last));
        f->alone = g->state;
        f->u_alone = g->u_last;
        f->error = R(0.0);
    }
}

/* A level is left for a worse one as soon as the forecasts are worse than its threshold, and taken again once they are
 * twice as good. */
static int level_for(int now, real forecast_error) {
    int worst = 0, best = 0;
    for (int i = 0; i < 2; i++) {
        worst += forecast_error > thresholds[i];
        best += forecast_error > R(0.5) * thresholds[i];
    }
    const int kept = now < best ? now : best;
    return worst > kept ? worst : kept;
}

static void propose_inverse_pid(hystmpc_feedback *f, const given *g, proposal *out) {
    const real wanted = feedforward_command(&f->alone, &f->followed, g->reference[0], f->u_alone);
    const real u_alone = within_limits(wanted, f->u_alone);
    state_advance(&f->alone, u_alone);
    f->u_alone = u_alone;
    if (g->age < f->age + R(1.0)) f->error = g->due - g->measured;
    out->u = correct_pid(f, f->error, g, u_alone);
}

/* One of three laws acts. It changes where the forecasts get better or worse; the command has no jump then. */
HYSTMPC_LOCAL void propose_supervised(hystmpc_controller *c, const given *g, proposal *out) {
    const int level = level_for(c->feedback.level, g->forecast_error);
    const hystmpc_feedback before = c->feedback;
    const int holding = c->holding, constant = c->constant;
    const real hold_target = c->hold_target;
    if (level != c->feedback.level) take_over(c, g, level);
    out->status = HYSTMPC_OK;
    out->source = HYSTMPC_FEEDBACK;
    out->planned = 0;
    if (level == PREDICTIVE) propose_predictive(c, g, out);
    else if (level == INVERSE_PID) propose_inverse_pid(&c->feedback, g, out);
    else out->u = correct_pid(&c->feedback, g->setpoint - g->measured, g, HYSTMPC_LOWER);
    if (out->status == HYSTMPC_OK && !is_finite(out->u)) out->status = HYSTMPC_NO_COMMAND;
    if (out->status != HYSTMPC_OK) { /* a failed law remembers nothing */
        c->feedback = before;
        c->holding = holding;
        c->constant = constant;
        c->hold_target = hold_target;
    }
}

#endif
