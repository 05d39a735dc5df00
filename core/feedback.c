/* Feedforward and feedback, and the choice between them and the predictive law by the error of the forecasts. */
#include "controller.h"
#include "room.h"

/* The nearest admissible command; the last one where u is no number. */
HYSTMPC_LOCAL real hystmpc_within_limits(const hystmpc_problem *p, real u, real last) {
    const real at = clamp(last, p->lower, p->upper);
    const real low = most(p->lower, at - p->reach), high = least(p->upper, at + p->reach);
    return clamp(is_finite(u) ? u : last, low, high);
}

/* Whether the measurement is newer than the one that the PID has used last. */
static int measured_anew(const hystmpc_head *f, const hystmpc_given *g) { return g->age < f->age + R(1.0); }

/* u = feedforward + kp e + I - kd dy/dt with I' = ki e + (u_limited - u) / tracking_s; the slope dy/dt is that between two
 * measurements, over the time between them. */
static real correct_pid(const hystmpc_problem *p, hystmpc_head *f, real error, const hystmpc_given *g,
                        real feedforward) {
    const hystmpc_gains *k = p->law->gains;
    const int fresh = measured_anew(f, g);
    const real age = f->age + R(1.0), span = p->upper - p->lower;
    if (fresh) {
        const real elapsed = p->dt_s * most(age - g->age, R(1.0));
        f->speed += elapsed / (k->filter_s + elapsed) * ((g->measured - f->angle) / elapsed - f->speed);
    }
    const real u = feedforward + k->kp * error + f->integral - k->kd * f->speed;
    const real excess = hystmpc_within_limits(p, u, g->u_last) - u;
    const real integrated = absolute(error) > k->dead_zone ? error : R(0.0);
    const real integral = f->integral + p->dt_s * (k->ki * integrated + excess / k->tracking_s);
    f->integral = clamp(integral, -span, span);
    f->angle = fresh ? g->measured : f->angle;
    f->age = fresh ? g->age : age;
    return u;
}

/* The memory with which the next command is the last one sent: a bumpless transfer. */
static void take_over_pid(const hystmpc_problem *p, hystmpc_head *f, real error, const hystmpc_given *g,
                          real feedforward) {
    f->integral = g->u_last - feedforward - p->law->gains->kp * error;
    f->speed = R(0.0);
    f->angle = g->measured;
    f->age = g->age;
}

/* Commands of a feedforward from the state x: the inverse of the angle followed, sample by sample or over a preview.
 * Changes of the reference within the dead zone are not followed: noise on it would flip the branch of the inverse and
 * jump across the whole dead band (RA-L 2024, PMC11633443 (S2), inverse backlash). */
static void feed_forward(const hystmpc_problem *p, hystmpc_memory *m, const real *x, real u_last,
                         const real *reference, hystmpc_proposal *out, char *room) {
    hystmpc_head *f = m->head;
    room = room_begin(room);
    const int ahead = p->law->kind != HYSTMPC_PREDICTIVE && p->law->planner, samples = ahead ? p->law->horizon : 1;
    real *wanted = room_take(&room, samples), before = f->followed;
    for (int k = 0; k < samples; k++) {
        if (absolute(reference[k] - before) >= p->law->dead_zone) before = reference[k];
        wanted[k] = before;
    }
    f->followed = wanted[0];
    out->status = HYSTMPC_OK;
    if (!ahead) {
        if (hystmpc_model_command(p->model, x, f->followed, u_last, &out->u, room)) out->status = HYSTMPC_FAILED;
        return;
    }
    hystmpc_plan best = {out->commands, out->angles, R(0.0)};
    const int answer =
        hystmpc_plan_ahead(p, x, wanted, u_last, m->fed, f->fed, p->law->dead_zone, &best, room);
    out->fault = answer;
    if (answer < 0) {
        out->status = answer == HYSTMPC_NO_ANSWER          ? HYSTMPC_FAILED
                      : answer >= HYSTMPC_QP_UNFINISHED ? HYSTMPC_NO_SOLUTION
                                                        : HYSTMPC_NO_PLAN;
        return;
    }
    out->u = best.commands[0];
    out->planned = samples;
    f->fed = samples - 1;
    copy(best.commands + 1, m->fed, f->fed);
}

/* The angle that was due when the last measurement was taken [deg]. */
static real due_then(const hystmpc_memory *m, real age) {
    const int known = m->head->dues;
    const real back = MATH(rint)(age);
    const int ago = !(back > R(0.0)) ? 0 : back < (real)(known - 1) ? (int)back : known - 1;
    return m->due[known - 1 - ago];
}

/* A feedforward with PID feedback. The feedback compares the measurement with the angle that was due when it was taken;
 * the inverse remembers its own commands, not the sum, which would cross the dead band to undo every correction. */
static void feed_forward_and_back(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g,
                                  hystmpc_proposal *out, char *room) {
    hystmpc_head *f = m->head;
    const int kept = p->sensing->oldest + 1;
    real theta;
    feed_forward(p, m, m->alone, f->u_alone, g->reference, out, room);
    if (out->status != HYSTMPC_OK) return;
    f->u_alone = hystmpc_within_limits(p, out->u, f->u_alone);
    if (hystmpc_model_advance(p->model, m->alone, f->u_alone, &theta, room)) {
        out->status = HYSTMPC_FAILED;
        return;
    }
    if (f->dues == kept)
        for (int k = 1; k < kept; k++) m->due[k - 1] = m->due[k];
    else
        f->dues++;
    m->due[f->dues - 1] = g->due;
    if (measured_anew(f, g)) f->error = due_then(m, g->age) - g->measured;
    out->u = correct_pid(p, f, f->error, g, f->u_alone);
    out->planned = 0;
}

/* The predictive law has done nothing yet. */
static void forget_hold(hystmpc_head *f) {
    f->holding = f->constant = 0;
    f->hold_target = (real)NAN;
}

enum { SUPERVISED_MPC = 0, SUPERVISED_FEEDFORWARD = 1, SUPERVISED_PID = 2 };

static void begin_alone(const hystmpc_problem *p, hystmpc_memory *m, const real *x, real u) {
    if (p->model) copy(x, m->alone, hystmpc_model_states(p->model));
    m->head->u_alone = u;
    m->head->error = R(0.0);
    m->head->dues = 0;
    m->head->fed = 0;
}

HYSTMPC_LOCAL void hystmpc_forget_law(const hystmpc_problem *p, hystmpc_memory *m, const real *x, real y, real u) {
    hystmpc_head *f = m->head;
    f->level = SUPERVISED_MPC;
    f->draws = 0;
    forget_hold(f);
    begin_alone(p, m, x, u);
    f->followed = f->angle = y;
    f->integral = p->law->kind == HYSTMPC_PID ? u - p->lower : R(0.0);
    f->speed = f->age = R(0.0);
}

static int take_over(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g, int level, char *room) {
    hystmpc_head *f = m->head;
    f->level = level;
    if (level == SUPERVISED_MPC) {
        forget_hold(f);
    } else if (level == SUPERVISED_PID) {
        take_over_pid(p, f, g->setpoint - g->measured, g, p->lower);
    } else {
        real before = f->followed = g->due, alone;
        if (absolute(g->reference[0] - before) >= p->law->dead_zone) before = g->reference[0];
        if (hystmpc_model_command(p->model, g->state, before, g->u_last, &alone, room)) return 1;
        take_over_pid(p, f, g->due - g->measured, g, hystmpc_within_limits(p, alone, g->u_last));
        begin_alone(p, m, g->state, g->u_last);
    }
    return 0;
}

/* A level is left for a worse one as soon as the error of the forecasts is above its threshold, and taken again once that
 * is below half of it. */
static int level_for(const hystmpc_control_law *law, int now, real forecast_error) {
    const real thresholds[2] = {law->inverse_pid_above, law->pid_above};
    int worst = 0, best = 0;
    for (int i = 0; i < 2; i++) {
        worst += forecast_error > thresholds[i];
        best += forecast_error > R(0.5) * thresholds[i];
    }
    const int kept = now < best ? now : best;
    return worst > kept ? worst : kept;
}

/* One of three laws acts. It changes where the forecasts get better or worse; the command has no jump then. */
static void propose_supervised(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g,
                               hystmpc_proposal *out, char *room) {
    hystmpc_head *f = m->head;
    const int level = level_for(p->law, f->level, g->forecast_error);
    out->status = HYSTMPC_OK;
    if (level != f->level && take_over(p, m, g, level, room)) {
        out->status = HYSTMPC_FAILED;
    } else if (level == SUPERVISED_MPC) {
        hystmpc_propose_plan(p, f, g, out, room);
    } else {
        if (level == SUPERVISED_FEEDFORWARD) feed_forward_and_back(p, m, g, out, room);
        else out->u = correct_pid(p, f, g->setpoint - g->measured, g, p->lower);
        out->source = HYSTMPC_FEEDBACK;
        out->planned = 0;
    }
}

static void propose_by_kind(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g,
                            hystmpc_proposal *out, char *room) {
    out->status = HYSTMPC_OK;
    out->source = HYSTMPC_FEEDBACK;
    switch (p->law->kind) {
    case HYSTMPC_PREDICTIVE:
        if (p->law->supervised) propose_supervised(p, m, g, out, room);
        else hystmpc_propose_plan(p, m->head, g, out, room);
        return;
    case HYSTMPC_FEEDFORWARD: feed_forward(p, m, g->state, g->u_last, g->reference, out, room); return;
    case HYSTMPC_FEEDFORWARD_PID: feed_forward_and_back(p, m, g, out, room); return;
    case HYSTMPC_PID: out->u = correct_pid(p, m->head, g->setpoint - g->measured, g, p->lower); return;
    default:
        if (!p->law->propose || p->law->propose(g, out)) out->status = HYSTMPC_FAILED;
    }
}

/* What a law changes in a memory besides its head. */
static long changed_numbers(const hystmpc_problem *p) {
    return (p->model ? hystmpc_model_states(p->model) : 0) + p->law->horizon + p->sensing->oldest + 1;
}

HYSTMPC_LOCAL long hystmpc_law_room(const hystmpc_problem *p) {
    const long horizon = p->law->horizon;
    long bytes = 0;
    if (p->law->planner) bytes = hystmpc_predictive_room(p);
    if (p->model) bytes = longer(bytes, hystmpc_model_bytes(p->model, 1, 1));
    return 2 * ROOM_LINE + bytes + room_for(horizon) + room_for(changed_numbers(p));
}

HYSTMPC_LOCAL void hystmpc_propose(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g,
                                   hystmpc_proposal *out, char *room) {
    const hystmpc_head before = *m->head;
    const int states = p->model ? hystmpc_model_states(p->model) : 0;
    room = room_begin(room);
    real *alone = room_take(&room, changed_numbers(p)), *fed = alone + states, *due = fed + p->law->horizon;
    copy(m->alone, alone, states);
    copy(m->fed, fed, before.fed);
    copy(m->due, due, before.dues);
    out->fault = out->planned = 0;
    out->u = (real)NAN;
    propose_by_kind(p, m, g, out, room);
    if (out->status == HYSTMPC_OK && !is_finite(out->u)) out->status = HYSTMPC_NO_COMMAND;
    if (out->status == HYSTMPC_OK) return;
    *m->head = before; /* a law that failed remembers nothing */
    copy(alone, m->alone, states);
    copy(fed, m->fed, before.fed);
    copy(due, m->due, before.dues);
}
