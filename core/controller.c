/* One step of a controller: observer, law, fallbacks, limits. */
#include "controller.h"
#include "room.h"

#include <string.h>

static int states_of(const hystmpc_problem *p) { return p->model ? hystmpc_model_states(p->model) : 0; }

/* Numbers of a memory behind head and observer: plan, predicted, fed, alone, due. */
static long numbers_behind(const hystmpc_problem *p) {
    return 3L * p->law->horizon + states_of(p) + p->sensing->oldest + 1;
}

static long head_bytes(void) { return (long)((sizeof(hystmpc_head) + 7) / 8 * 8); }

long hystmpc_memory_bytes(const void *problem) {
    const hystmpc_problem *p = problem;
    const long numbers = numbers_behind(p) * (long)sizeof(real);
    return head_bytes() + hystmpc_observed_bytes(p->sensing, p->model) + (numbers + 7) / 8 * 8;
}

static int within(int count, int most_of_it) { return count < 0 ? 0 : count < most_of_it ? count : most_of_it; }

/* Parts of a memory; counts that a foreign memory may have wrong are kept within them. */
void hystmpc_memory_at(const hystmpc_problem *p, char *memory, hystmpc_memory *m) {
    const int horizon = p->law->horizon;
    m->head = (hystmpc_head *)(void *)memory;
    hystmpc_observed_at(p->sensing, p->model, memory + head_bytes(), &m->observed);
    m->plan = (real *)(void *)(memory + head_bytes() + hystmpc_observed_bytes(p->sensing, p->model));
    m->predicted = m->plan + horizon;
    m->fed = m->predicted + horizon;
    m->alone = m->fed + horizon;
    m->due = m->alone + states_of(p);
    m->head->planned = within(m->head->planned, horizon);
    m->head->fed = within(m->head->fed, horizon);
    m->head->dues = within(m->head->dues, p->sensing->oldest + 1);
}

int hystmpc_reference_samples(const void *problem) {
    const hystmpc_problem *p = problem;
    return p->law->horizon + p->sensing->delay;
}

/* Room of a step: reference, state, proposal, and what the functions take. */
long hystmpc_room_bytes(const void *problem) {
    const hystmpc_problem *p = problem;
    const long numbers = hystmpc_reference_samples(p) + 2L * p->law->horizon + states_of(p);
    long parts = longer(hystmpc_law_room(p), hystmpc_observer_bytes(p->sensing, p->model));
    if (p->model) parts = longer(parts, hystmpc_model_bytes(p->model, 1, 1));
    return 6L * ROOM_LINE + numbers * (long)sizeof(real) + parts;
}

static int started(const hystmpc_memory *m) { return m->head->mark == HYSTMPC_MARK; }

static hystmpc_known *known_of(const hystmpc_memory *m) { return m->observed.now.known; }

/* A command from outside within the limits on value; `otherwise` where it is no number. */
static real within_range(const hystmpc_problem *p, real u, real otherwise) {
    return clamp(is_finite(u) ? u : otherwise, p->lower, p->upper);
}

static void latch(hystmpc_head *head) {
    head->stopped = 1;
    head->planned = head->failures = 0;
}

void hystmpc_controller_stop(const void *problem, char *memory) {
    hystmpc_memory m;
    hystmpc_memory_at(problem, memory, &m);
    latch(m.head);
}

void hystmpc_controller_hurry(const void *problem, char *memory) {
    hystmpc_memory m;
    hystmpc_memory_at(problem, memory, &m);
    m.head->hurried = 1;
}

void hystmpc_controller_target(const void *problem, char *memory, real angle_deg) {
    hystmpc_memory m;
    hystmpc_memory_at(problem, memory, &m);
    m.head->target = angle_deg;
}

void hystmpc_controller_held(const void *problem, char *memory, real command) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    known_of(&m)->command = command;
}

int hystmpc_controller_init(const void *problem, char *memory, const real *x, real angle_deg, real command,
                            char *room) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    room = room_begin(room);
    real *state = room_take(&room, states_of(p));
    int answer = is_finite(hystmpc_usable_angle(angle_deg)) ? HYSTMPC_STARTED : HYSTMPC_BAD_ANGLE;
    if (answer == HYSTMPC_STARTED && !(p->lower <= command && command <= p->upper)) answer = HYSTMPC_BAD_COMMAND;
    if (answer == HYSTMPC_STARTED)
        answer = hystmpc_observer_init(p->sensing, p->model, &m.observed, x, angle_deg, command, room);
    if (answer != HYSTMPC_STARTED) {
        if (!started(&m)) known_of(&m)->command = within_range(p, command, p->lower);
        latch(m.head);
        return answer;
    }
    hystmpc_observer_state(p->sensing, p->model, &m.observed, state);
    if (p->model) copy(x, state, p->model->predictor->states);
    hystmpc_forget_law(p, &m, state, angle_deg, command);
    hystmpc_head *head = m.head;
    head->mark = HYSTMPC_MARK;
    head->due = head->target = angle_deg;
    head->failures = head->stopped = head->hurried = head->planned = 0;
    return answer;
}

int hystmpc_controller_input(const void *problem, char *memory, int entry, real value) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    if (!started(&m) || !hystmpc_observer_input(p->sensing, p->model, &m.observed, entry, value)) return 0;
    m.alone[entry] = value;
    return 1;
}

int hystmpc_controller_measure(const void *problem, char *memory, real angle_deg, real age) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    return started(&m) && hystmpc_observer_correct_late(p->sensing, p->model, &m.observed, angle_deg, age);
}

int hystmpc_controller_look_on(const void *problem, char *memory, real angle_deg, real command, char *room) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    if (!started(&m)) return 1;
    room = room_begin(room);
    real *state = room_take(&room, states_of(p));
    const real y = hystmpc_usable_angle(angle_deg);
    hystmpc_observer_correct(p->sensing, p->model, &m.observed, angle_deg);
    if (is_finite(y)) m.head->due = y;
    const real u = within_range(p, command, known_of(&m)->command);
    hystmpc_observer_advance(p->sensing, p->model, &m.observed, u, room);
    hystmpc_observer_state(p->sensing, p->model, &m.observed, state);
    hystmpc_forget_law(p, &m, state, m.head->due, u);
    m.head->planned = 0;
    return known_of(&m)->stalled;
}

static void stop_command(const hystmpc_problem *p, const hystmpc_memory *m, hystmpc_proposal *out) {
    out->source = HYSTMPC_STOP;
    out->u = p->safe == p->safe ? p->safe : known_of(m)->command;
}

static void pause_command(hystmpc_memory *m, hystmpc_proposal *out) {
    out->source = HYSTMPC_HOLD;
    out->u = known_of(m)->command;
    m->head->planned = 0;
}

static void drop_first(real *from, int count) {
    for (int k = 0; k < count; k++) from[k] = from[k + 1];
}

/* The best level left after a failure: shifted plan, inverse, hold, stop. */
static void fall_back(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_given *g, int blind,
                      hystmpc_proposal *out, char *room) {
    hystmpc_head *head = m->head;
    out->planned = 0;
    head->failures = hystmpc_later(head->failures);
    if (head->failures >= p->stop_after) {
        head->stopped = 1;
        stop_command(p, m, out);
        return;
    }
    if (blind) {
        pause_command(m, out);
        return;
    }
    if (head->planned) {
        out->source = HYSTMPC_SHIFTED_PLAN;
        out->u = m->plan[0];
        out->planned = head->planned;
        copy(m->plan, out->commands, head->planned);
        copy(m->predicted, out->angles, head->planned);
        head->planned--;
        drop_first(m->plan, head->planned);
        drop_first(m->predicted, head->planned);
        return;
    }
    out->source = HYSTMPC_INVERSE;
    if (p->falls_back_on_inverse && p->model) {
        const real wanted = g->reference[0] - g->disturbance;
        const int failed = hystmpc_model_command(p->model, g->state, wanted, g->u_last, &out->u, room);
        if (!failed && is_finite(out->u)) return;
        out->inverse = failed ? 2 : 1;
    }
    out->source = HYSTMPC_HOLD;
    out->u = g->u_last;
}

/* What the law may look at. */
static void look(const hystmpc_problem *p, const hystmpc_memory *m, const real *wanted, real *state,
                 hystmpc_given *g) {
    const hystmpc_known *known = known_of(m);
    hystmpc_observer_state(p->sensing, p->model, &m->observed, state);
    g->state = state;
    g->reference = wanted + p->sensing->delay;
    g->remaining = m->plan;
    g->planned = m->head->planned;
    g->disturbance = known->disturbance;
    g->sigma = hystmpc_observer_sigma(p->sensing, &m->observed);
    g->close = hystmpc_observer_close(p->sensing, &m->observed);
    g->measured = known->measured;
    g->age = hystmpc_observer_age(&m->observed);
    g->u_last = known->command;
    g->due = m->head->due;
    g->setpoint = wanted[0];
    g->forecast_error = known->forecast_error;
}

/* The level to take. */
static void decide(const hystmpc_problem *p, hystmpc_memory *m, const real *reference, hystmpc_proposal *out,
                   char *room) {
    const int samples = hystmpc_reference_samples(p);
    hystmpc_head *head = m->head;
    hystmpc_given g;
    room = room_begin(room);
    real *wanted = room_take(&room, samples), *state = room_take(&room, states_of(p));
    out->planned = out->fault = 0;
    if (head->stopped) {
        out->status = HYSTMPC_LATCHED;
        stop_command(p, m, out);
        return;
    }
    for (int k = 0; k < samples; k++) {
        wanted[k] = reference ? reference[k] : head->target;
        if (!(absolute(wanted[k]) <= HYSTMPC_ANGLE_BOUND)) {
            out->status = HYSTMPC_BAD_REFERENCE;
            pause_command(m, out);
            return;
        }
    }
    look(p, m, wanted, state, &g);
    head->due = g.setpoint;
    const int blind = known_of(m)->missing > p->most_missing;
    if (blind) out->status = HYSTMPC_NO_SENSOR_NOW;
    else if (known_of(m)->stalled) out->status = HYSTMPC_STALE_MODEL;
    else if (head->hurried) out->status = HYSTMPC_NO_TIME;
    else hystmpc_propose(p, m, &g, out, room);
    if (out->status != HYSTMPC_OK) {
        fall_back(p, m, &g, blind, out, room);
        return;
    }
    head->failures = 0;
    head->planned = out->planned > 0 ? out->planned - 1 : 0;
    copy(out->commands + 1, m->plan, head->planned);
    copy(out->angles + 1, m->predicted, head->planned);
}

/* What stands still where nothing has been started; of that memory nothing but a number is read. */
static void stand_still(const hystmpc_problem *p, const hystmpc_memory *m, hystmpc_command *answer, real *plan) {
    if (plan) fill(plan + p->law->horizon, (real)NAN, p->sensing->delay + 1);
    answer->u = within_range(p, known_of(m)->command, p->lower);
    answer->predicted_deg = (real)NAN;
    answer->source = HYSTMPC_STOP;
    answer->status = HYSTMPC_LATCHED;
}

/* The angle expected at the end of sample k from now, disturbance included: of commands on their way, then of the plan. */
static real foreseen_angle(const hystmpc_problem *p, const hystmpc_memory *m, const hystmpc_proposal *out, int k) {
    const int delay = p->sensing->delay, planned = out->planned && k >= delay;
    return (planned ? out->angles[k - delay] : m->observed.now.angles[k]) + known_of(m)->disturbance;
}

HYSTMPC_LOCAL int hystmpc_controller_begin(const hystmpc_problem *p, hystmpc_memory *m, real angle_deg, const real *reference,
                                           hystmpc_proposal *out, char *room) {
    if (!started(m)) return 0;
    hystmpc_observer_correct(p->sensing, p->model, &m->observed, angle_deg);
    decide(p, m, reference, out, room);
    m->head->hurried = 0;
    return 1;
}

HYSTMPC_LOCAL int hystmpc_controller_finish(const hystmpc_problem *p, hystmpc_memory *m, const hystmpc_proposal *out, int foretells,
                                            hystmpc_command *answer, char *room) {
    const hystmpc_known *known = known_of(m);
    answer->missing = known->missing;
    answer->u = hystmpc_within_limits(p, out->u, known->command);
    hystmpc_observer_advance(p->sensing, p->model, &m->observed, answer->u, room);
    answer->source = out->source;
    answer->status = out->status;
    answer->fault = out->fault;
    answer->planned = out->planned;
    answer->inverse = out->inverse;
    answer->departure_deg = known->disturbance + known->added;
    answer->predicted_deg = (real)NAN;
    if (p->model) answer->predicted_deg = foreseen_angle(p, m, out, 0);
    const int foreseen = !p->model || !foretells ? 0 : out->planned ? out->planned : p->sensing->delay + 1;
    for (int k = foreseen - 1; k >= 0; k--) out->angles[k] = foreseen_angle(p, m, out, k); /* of those before it */
    const int supervised = out->source == HYSTMPC_FEEDBACK && m->head->level;
    return out->status != HYSTMPC_OK || out->fault > 0 || known->missing || known->stalled || supervised;
}

int hystmpc_controller_step(const void *problem, char *memory, real angle_deg, const real *reference, void *command,
                            real *plan, char *room) {
    const hystmpc_problem *p = problem;
    const int horizon = p->law->horizon;
    hystmpc_memory m;
    hystmpc_proposal out;
    hystmpc_memory_at(p, memory, &m);
    memset(command, 0, sizeof(hystmpc_command));
    memset(&out, 0, sizeof out);
    room = room_begin(room);
    out.commands = plan ? plan : room_take(&room, 2L * horizon);
    out.angles = out.commands + horizon;
    if (hystmpc_controller_begin(p, &m, angle_deg, reference, &out, room))
        return hystmpc_controller_finish(p, &m, &out, plan != NULL, command, room);
    stand_still(p, &m, command, plan);
    return 1;
}

void hystmpc_controller_look(const void *problem, const char *memory, real *numbers, real *x, real *angles, real *moves,
                             real *responsive, real *bank) {
    const hystmpc_problem *p = problem;
    hystmpc_memory m;
    hystmpc_memory_at(p, (char *)memory, &m); /* counts alone may change */
    const hystmpc_known *k = known_of(&m);
    const hystmpc_head *h = m.head;
    const int entries = p->sensing->delay + 1;
    const real all[16] = {k->command, k->disturbance, k->variance, k->measured, hystmpc_observer_age(&m.observed),
                          k->added, k->forecast_error, hystmpc_observer_sigma(p->sensing, &m.observed), h->due,
                          (real)k->missing, (real)k->stalled, (real)h->failures, (real)h->stopped, (real)h->level,
                          (real)h->holding, (real)h->constant};
    copy(all, numbers, 16);
    if (!p->model) return;
    if (x) hystmpc_observer_state(p->sensing, p->model, &m.observed, x);
    if (angles) copy(m.observed.now.angles, angles, entries);
    if (moves) copy(m.observed.now.moves, moves, entries);
    if (responsive) copy(m.observed.now.responsive, responsive, entries);
    const hystmpc_noise *n = p->sensing->noise;
    if (bank && n) copy(m.observed.now.bank, bank, 3 * n->sensors * n->drifts * n->motions);
}
