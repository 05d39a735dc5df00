/* A law inside an estimator, a chain of fallbacks and hard limits: a step never fails and never leaves the limits. */
#include "internal.h"

unsigned long hystmpc_memory_bytes(void) { return (unsigned long)sizeof(hystmpc_controller); }

static int started(const hystmpc_controller *c) { return c->estimate.started == HYSTMPC_MARK; }

/* A command from outside within the limits on value; `otherwise` where it is no number. */
static real within_range(real u, real otherwise) {
    return clamp(is_finite(u) ? u : otherwise, HYSTMPC_LOWER, HYSTMPC_UPPER);
}

/* The law has done nothing yet. */
static void forget(hystmpc_controller *c) {
    init_predictive(c);
#if HYSTMPC_SUPERVISED
    init_supervisor(c);
#endif
    c->planned = 0;
}

int hystmpc_init(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command) {
#if HYSTMPC_LEARNS
    const int answer = estimate_init(&c->plain, angle_deg, command);
#else
    const int answer = estimate_init(&c->estimate, angle_deg, command);
#endif
    if (answer != HYSTMPC_STARTED) {
        if (!started(c)) c->estimate.command = within_range(command, HYSTMPC_LOWER);
        hystmpc_stop(c);
        return answer;
    }
#if HYSTMPC_LEARNS
    c->estimate = c->plain;
    hystmpc_learning_init(&hystmpc_learns, c->learning.past, &c->learning.filters, c->plain.angles[0], command, angle_deg);
    fill(c->learning.added, R(0.0), HYSTMPC_UNDER_WAY);
#endif
    forget(c);
    c->due = c->target = angle_deg;
    c->failures = c->stopped = c->hurried = 0;
    return answer;
}

void hystmpc_set_target(hystmpc_controller *c, hystmpc_real angle_deg) { c->target = angle_deg; }

void hystmpc_hurry(hystmpc_controller *c) { c->hurried = 1; }

void hystmpc_stop(hystmpc_controller *c) {
    c->stopped = 1;
    c->planned = c->failures = 0;
}

#if HYSTMPC_LEARNS

/* The whole's angles from those of the model alone and what is learned. */
static void put_together(hystmpc_controller *c) {
    hystmpc_estimate *whole = &c->estimate;
    hystmpc_learning *l = &c->learning;
    hystmpc_learning_added(&hystmpc_learns, l->past, &l->filters, c->plain.angles, l->added);
    for (int k = 0; k < HYSTMPC_UNDER_WAY; k++) whole->angles[k] = c->plain.angles[k] + l->added[k];
}

/* Model, learned part and disturbance corrected. Where weights change the disturbance takes up the difference, so that
 * the angle of now has no jump. An angle far from the prediction counts where the device can have gone there. */
static void correct(hystmpc_controller *c, real y) {
    hystmpc_estimate *whole = &c->estimate, *plain = &c->plain;
    const real angle = usable_angle(y), offset = angle - whole->angles[0];
    hystmpc_learning *l = &c->learning;
    const real reach = HYSTMPC_OUTLIER + hystmpc_learning_reach(&hystmpc_learns, l->past), before = l->added[0];
    if (!(absolute(offset - whole->disturbance) <= HYSTMPC_OUTLIER || absolute(angle - whole->measured) <= reach)) {
        whole->missing = later(whole->missing);
        return;
    }
    hystmpc_learning_correct(&hystmpc_learns, l->past, &l->filters, angle, plain->angles[0], plain->disturbance);
    estimate_correct(plain, angle);
    plain->measured = whole->measured = angle;
    plain->missing = whole->missing = 0;
    put_together(c);
    const real change = l->added[0] - before;
    for (int i = 0; i < HYSTMPC_FILTERS; i++) whole->bank[0][i] -= change;
    if (!plain->responsive[0]) whole->disturbance -= change;
    else whole->variance = hystmpc_noise_correct(&hystmpc_noises, whole->bank[0], offset - change, &whole->disturbance);
}

static void advance(hystmpc_controller *c, real u) {
    estimate_advance(&c->plain, u);
    hystmpc_learning_advance(&hystmpc_learns, c->learning.past, u);
    hystmpc_estimate *whole = &c->estimate;
    whole->variance = hystmpc_noise_advance(&hystmpc_noises, whole->bank[0], c->plain.moves[0], whole->disturbance);
    whole->command = u;
    whole->stalled = c->plain.stalled;
    put_together(c);
}

#else

static void correct(hystmpc_controller *c, real y) { estimate_correct(&c->estimate, y); }
static void advance(hystmpc_controller *c, real u) { estimate_advance(&c->estimate, u); }

#endif

/* What the law may look at; `wanted` are the HYSTMPC_REFERENCE angles. */
static void look(const hystmpc_controller *c, const real *wanted, given *g) {
    const hystmpc_estimate *e = &c->estimate;
#if HYSTMPC_LEARNS
    copy(c->plain.model, g->state.model, S);
    hystmpc_learning_state(&hystmpc_learns, c->learning.past, &c->learning.filters, &g->state.learned);
    g->state.acts = 0;
    for (int i = 0; i < HYSTMPC_WEIGHTS; i++)
        if (g->state.learned.weights[i] != R(0.0)) g->state.acts = 1;
    g->forecast_error = c->learning.filters.forecast_error;
#else
    copy(e->model, g->state.model, S);
    g->forecast_error = R(0.0);
#endif
    copy(wanted + HYSTMPC_DELAY, g->reference, H);
    g->disturbance = e->disturbance;
    g->sigma = root(e->variance);
    g->measured = e->measured;
    g->age = (real)e->missing;
    g->u_last = e->command;
    g->due = c->due;
    g->setpoint = wanted[0];
}

static void stop_command(const hystmpc_controller *c, proposal *out) {
    out->source = HYSTMPC_STOP;
    out->u = HYSTMPC_SAFE_KNOWN ? HYSTMPC_SAFE : c->estimate.command;
}

static void pause_command(hystmpc_controller *c, proposal *out) {
    out->source = HYSTMPC_HOLD;
    out->u = c->estimate.command;
    c->planned = 0;
}

static void drop_first(real *from, int count) {
    for (int k = 0; k < count; k++) from[k] = from[k + 1];
}

/* The best level left after a failure: shifted plan, inverse, hold, stop. */
static void fall_back(hystmpc_controller *c, const given *g, int blind, proposal *out) {
    out->planned = 0;
    c->failures++;
    if (c->failures >= HYSTMPC_STOP_AFTER) {
        c->stopped = 1;
        stop_command(c, out);
        return;
    }
    if (blind) {
        pause_command(c, out);
        return;
    }
    if (c->planned) {
        out->source = HYSTMPC_SHIFTED_PLAN;
        out->u = c->plan[0];
        out->planned = c->planned;
        copy(c->predicted, out->angles, c->planned);
        c->planned--;
        drop_first(c->plan, c->planned);
        drop_first(c->predicted, c->planned);
        return;
    }
    out->source = HYSTMPC_INVERSE;
    out->u = state_inverse(&g->state, g->reference[0] - g->disturbance, g->u_last);
    if (is_finite(out->u)) return;
    out->source = HYSTMPC_HOLD;
    out->u = g->u_last;
}

static void propose(hystmpc_controller *c, const given *g, proposal *out) {
    if (c->estimate.stalled) {
        out->status = HYSTMPC_STALE_MODEL;
        return;
    }
    if (c->hurried) {
        out->status = HYSTMPC_NO_TIME;
        return;
    }
#if HYSTMPC_SUPERVISED
    propose_supervised(c, g, out);
#else
    propose_predictive(c, g, out);
#endif
    if (out->status == HYSTMPC_OK && !is_finite(out->u)) out->status = HYSTMPC_NO_COMMAND;
}

/* The level to take. */
static void decide(hystmpc_controller *c, const real *reference, proposal *out) {
    real wanted[HYSTMPC_REFERENCE];
    given g;
    out->planned = 0;
    if (c->stopped) {
        out->status = HYSTMPC_LATCHED;
        stop_command(c, out);
        return;
    }
    for (int k = 0; k < HYSTMPC_REFERENCE; k++) {
        wanted[k] = reference ? reference[k] : c->target;
        if (!(absolute(wanted[k]) <= HYSTMPC_ANGLE_BOUND)) {
            out->status = HYSTMPC_BAD_REFERENCE;
            pause_command(c, out);
            return;
        }
    }
    look(c, wanted, &g);
    c->due = g.setpoint;
    if (c->estimate.missing > HYSTMPC_MOST_MISSING) {
        out->status = HYSTMPC_NO_SENSOR;
        fall_back(c, &g, 1, out);
        return;
    }
    propose(c, &g, out);
    if (out->status != HYSTMPC_OK) {
        fall_back(c, &g, 0, out);
        return;
    }
    c->failures = 0;
    c->planned = out->planned > 0 ? out->planned - 1 : 0;
    copy(out->commands + 1, c->plan, c->planned);
    copy(out->angles + 1, c->predicted, c->planned);
}

int hystmpc_look_on(hystmpc_controller *c, hystmpc_real angle_deg, hystmpc_real command) {
    if (!started(c)) return 1;
    correct(c, angle_deg);
    if (is_finite(usable_angle(angle_deg))) c->due = angle_deg;
    forget(c);
    advance(c, within_range(command, c->estimate.command));
    return c->estimate.stalled;
}

/* What stands still where nothing has been started; of that memory nothing but a number is read. */
static hystmpc_command stand_still(const hystmpc_controller *c) {
    hystmpc_command answer;
    answer.u = within_range(c->estimate.command, HYSTMPC_LOWER);
    answer.predicted_deg = (real)NAN;
    answer.departure_deg = R(0.0);
    answer.source = HYSTMPC_STOP;
    answer.status = HYSTMPC_LATCHED;
    answer.missing = 0;
    return answer;
}

hystmpc_command hystmpc_step(hystmpc_controller *c, hystmpc_real angle_deg, const hystmpc_real *reference) {
    hystmpc_command answer;
    proposal out;
    if (!started(c)) return stand_still(c);
    correct(c, angle_deg);
    decide(c, reference, &out);
    c->hurried = 0;
    answer.missing = c->estimate.missing;
    answer.u = within_limits(out.u, c->estimate.command);
    advance(c, answer.u);
    answer.source = out.source;
    answer.status = out.status;
    answer.predicted_deg =
        (HYSTMPC_DELAY == 0 && out.planned ? out.angles[0] : c->estimate.angles[0]) + c->estimate.disturbance;
    answer.departure_deg = c->estimate.disturbance;
#if HYSTMPC_LEARNS
    answer.departure_deg += c->learning.added[0];
#endif
    return answer;
}
