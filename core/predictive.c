/* The predictive law: candidate plans, the hold at a constant reference, the best plan improved; and the inverse over a
 * preview, which is the same problem without disturbance and hold. */
#include "controller.h"
#include "room.h"

#define PREDICTIVE_CLOSE R(0.5) /* probability from which on the model counts as close, and its plan is finished */

/* What both work on. */
typedef struct {
    const hystmpc_problem *problem;
    const hystmpc_planner *planner;
    const real *x; /* state from which predictions start */
    int horizon;
    real *plans, *angles; /* candidates (C, H) */
    real *targets;        /* (2, H) */
    char *room;           /* of the model's and the planner's functions */
} planning;

static long planning_room(const hystmpc_problem *p) {
    const hystmpc_planner *planner = p->law->planner;
    const long h = planner->law->horizon, count = p->law->candidates;
    const long candidates = 2 * room_for(count * h) + room_for(2 * h);
    return candidates + longer(hystmpc_model_bytes(p->model, (int)count, (int)h), hystmpc_planner_bytes(planner, p->model));
}

static void begin_planning(planning *q, const hystmpc_problem *p, const real *x, char *room) {
    const long h = p->law->planner->law->horizon;
    q->problem = p;
    q->planner = p->law->planner;
    q->x = x;
    q->horizon = (int)h;
    q->plans = room_take(&room, p->law->candidates * h);
    q->angles = room_take(&room, p->law->candidates * h);
    q->targets = room_take(&room, 2 * h);
    q->room = room;
}

/* Admissible plans to begin with; how many there are, or -1 where the inverse from outside has failed. */
static int build_candidates(const planning *q, const real *wanted, real u_last, const real *remaining, int left,
                            int resting) {
    const hystmpc_law *l = q->planner->law;
    const real bounds[3] = {l->lower, l->upper, l->reach};
    if (hystmpc_model_follow(q->problem->model, q->x, wanted, q->horizon, u_last, bounds, q->targets, q->room)) return -1;
    copy(q->targets + q->horizon, q->plans + HYSTMPC_INVERTED * q->horizon, q->horizon);
    return hystmpc_candidates(l, q->targets, remaining, left, u_last, resting, q->plans);
}

/* Angles of the candidates from `first` to `last`; the cheapest of them, if it is cheaper than the best so far. 0, or
 * another number where the model from outside has failed. */
static int predict_candidates(const planning *q, int first, int last) {
    const long at = (long)first * q->horizon;
    return first == last ? 0
                         : hystmpc_model_run(q->problem->model, q->x, last - first, q->horizon, q->plans + at,
                                             q->angles + at, q->room);
}

static void take_cheapest(const planning *q, const hystmpc_task *task, int first, int last, hystmpc_plan *best) {
    for (int n = first; n < last; n++) {
        const real *commands = q->plans + (long)n * q->horizon, *angles = q->angles + (long)n * q->horizon;
        const real cost = hystmpc_plan_cost(q->planner->law, task, commands, angles);
        if (n > 0 && !(cost < best->cost)) continue;
        copy(commands, best->commands, q->horizon);
        copy(angles, best->angles, q->horizon);
        best->cost = cost;
    }
}

/* The greatest distance of angles from the target; not-a-number where one is. */
static real farthest(const real *angles, int count, real shift, real target) {
    real most_off = R(0.0);
    for (int k = 0; k < count; k++) {
        const real off = absolute(angles[k] + shift - target);
        if (!(off <= most_off)) most_off = off;
        if (off != off) break;
    }
    return most_off;
}

/* A setting by the probability that the model is as close to the device as its file says. Then moves cost little, since
 * they are those of the reference, and holds are exact. Where it is not, the estimate of its error makes moves of its own,
 * and a lag that the model lacks an oscillation. In between the logarithms are weighted: of two values a hundredfold apart
 * a mean is the greater one. */
static real by_closeness(real far, real close, real probability) {
    return probability < R(1.0) && far != close ? far * MATH(pow)(close / far, probability) : close;
}

/* Whether to hold now: the reference has come to rest, and the held command keeps the angle close to it: within the
 * tolerance, and one standard deviation of the disturbance more for each `patience` that has passed, since noise may
 * prevent a closer approach; once held, `sigmas` of them.
 *
 * A reading of resolution q is constant while the angle stays within q / 2 of it. At rest the estimate drifts to the
 * reading, and corrections would go on until the reading changes, then reverse: a limit cycle. Once held, q more is close
 * enough: an angle within q / 2 of the wanted one is never left, one more than 3 q / 2 away always is.
 *
 * When the reference will move again, the hold is left as late as `can_wait` says. */
static void judge_hold(const hystmpc_hold *rule, hystmpc_head *head, const hystmpc_given *g, const real *held,
                       int horizon, real tolerance) {
    const int held_before = head->holding;
    const real now = g->reference[0];
    head->holding = 0;
    if (!(absolute(now - head->hold_target) <= tolerance)) {
        head->constant = 0;
        head->hold_target = now;
        return;
    }
    head->constant = hystmpc_later(head->constant);
    const real waited = least((real)(head->constant / rule->patience), rule->sigmas);
    const real more = held_before ? rule->sigmas * g->sigma + rule->step : waited * g->sigma;
    head->holding = farthest(held, horizon, g->disturbance, head->hold_target) <= tolerance + more;
    /* What the model knows of the way of a held angle, creep for one, is no noise; what it has learned may be. */
    head->crept = held_before && horizon > 1 ? head->crept + held[1] - held[0] : R(0.0);
    head->holding = head->holding && absolute(head->crept) <= R(3.0) * tolerance + more;
}

/* In a hold the plan within u_last -+ k error / (slope settle), k = 1, 2, ...; whether it has changed. Where the model has a
 * dead band that the device does not have, a plan crosses it at no cost and the next one returns: a limit cycle. A
 * correction of the size that is needed outside dead bands meets the measurement in time; a true dead band is still
 * crossed, some samples later. */
static int limit_correction(const hystmpc_problem *p, const hystmpc_head *head, real *commands, real u_last,
                            real error) {
    const hystmpc_hold *rule = p->law->hold;
    const hystmpc_law *l = p->law->planner->law;
    if (!(rule->settle > 0 && head->constant > rule->settle_after && p->law->slope > R(0.0))) return 0;
    for (int k = 0; k < l->horizon; k++) {
        const real reach = error / (p->law->slope * (real)rule->settle) * (real)(k + 1);
        commands[k] = clamp(commands[k], u_last - reach, u_last + reach);
    }
    hystmpc_clip_plan(l->horizon, l->lower, l->upper, l->reach, u_last, commands);
    return 1;
}

/* The status of a law whose planner answers so. */
static int status_of_planner(int answer) {
    if (answer >= 0) return HYSTMPC_OK;
    if (answer >= HYSTMPC_QP_UNFINISHED) return HYSTMPC_NO_SOLUTION;
    return answer >= HYSTMPC_NO_PREDICTION ? HYSTMPC_NO_PLAN : HYSTMPC_FAILED;
}

static void refuse_plan(hystmpc_proposal *out, int status, int fault) {
    out->status = status;
    out->fault = fault;
}

HYSTMPC_LOCAL long hystmpc_predictive_room(const hystmpc_problem *p) {
    return ROOM_LINE + planning_room(p) + room_for(p->law->planner->law->horizon);
}

/* The sample of the preview in which a constant reference moves again; the horizon where it does not. */
static int next_motion(const hystmpc_head *head, const hystmpc_given *g, int horizon, real tolerance) {
    int k = 0;
    while (k < horizon && absolute(g->reference[k] - head->hold_target) <= tolerance) k++;
    return k;
}

/* Whether the plan can begin one sample later: from `motion` on its angles then come as near to the wanted ones. The plan
 * that begins later is left in `late`; `out` says where the model from outside has failed.
 *
 * A command that has to cross a dead band, or to go through a drive, within its greatest rate begins before the reference
 * does; not earlier than it has to, since the device may answer, and the command would wander where it moves nothing. */
static int can_wait(const planning *q, const hystmpc_given *g, const hystmpc_task *task, const hystmpc_plan *best,
                    int motion, const hystmpc_plan *late, hystmpc_proposal *out) {
    const hystmpc_law *l = q->planner->law;
    const real tolerance = q->problem->law->hold->worth + g->sigma;
    copy(best->commands, late->commands, q->horizon);
    late->commands[0] = task->u_last;
    hystmpc_clip_plan(q->horizon, l->lower, l->upper, l->reach, task->u_last, late->commands);
    if (hystmpc_model_run(q->problem->model, q->x, 1, q->horizon, late->commands, late->angles, q->room)) {
        refuse_plan(out, HYSTMPC_FAILED, 0);
        return 0;
    }
    real travel = R(0.0); /* to the farthest command before the motion; a plan that first goes the other way wanders */
    for (int k = 0; k <= motion; k++)
        if (absolute(best->commands[k] - task->u_last) > absolute(travel)) travel = best->commands[k] - task->u_last;
    int near = 1;
    for (int k = motion; k < q->horizon; k++) {
        const real now = absolute(best->angles[k] - task->reference[k]), later = absolute(late->angles[k] - task->reference[k]);
        near &= later <= now + tolerance;
    }
    return near || travel * (best->commands[0] - task->u_last) <= R(0.0);
}

/* The plan improved; while the reference is constant it waits or is limited. */
static void improve_plan(const planning *q, hystmpc_head *head, const hystmpc_given *g, const hystmpc_task *task,
                         hystmpc_plan *best, hystmpc_proposal *out, int motion) {
    const real error = farthest(q->angles + HYSTMPC_HELD * q->horizon, q->horizon, g->disturbance, head->hold_target);
    const hystmpc_plan late = {q->plans + HYSTMPC_HELD * q->horizon, q->angles + HYSTMPC_HELD * q->horizon, R(0.0)};
    hystmpc_planner planner = *q->planner;
    if (g->close >= PREDICTIVE_CLOSE) planner.iterations = planner.close_iterations;
    const int answer = hystmpc_improve(&planner, q->problem->model, q->x, task, best, &head->draws, q->room);
    refuse_plan(out, status_of_planner(answer), answer);
    if (out->status != HYSTMPC_OK) return;
    const int waits = motion == q->horizon || head->constant == 0 || can_wait(q, g, task, best, motion, &late, out);
    if (out->status != HYSTMPC_OK) return;
    if (!waits) {
        head->holding = 0; /* the next motion begins */
    } else if (head->holding) {
        copy(late.commands, best->commands, q->horizon);
        copy(late.angles, best->angles, q->horizon);
    } else if (limit_correction(q->problem, head, best->commands, g->u_last, error) &&
               hystmpc_model_run(q->problem->model, q->x, 1, q->horizon, best->commands, best->angles, q->room)) {
        refuse_plan(out, HYSTMPC_FAILED, 0);
    }
}

/* The wanted command and the plan behind it; the caller restores the head where there is none. */
HYSTMPC_LOCAL void hystmpc_propose_plan(const hystmpc_problem *p, hystmpc_head *head, const hystmpc_given *g,
                                        hystmpc_proposal *out, char *room) {
    const int h = p->law->planner->law->horizon;
    const real tolerance = by_closeness(p->law->hold->tolerance, p->law->hold->close_tolerance, g->close);
    const int motion = next_motion(head, g, h, tolerance), resting = head->constant > 0 && motion == h;
    room = room_begin(room);
    real *wanted = room_take(&room, h);
    hystmpc_plan best = {out->commands, out->angles, R(0.0)};
    planning q;
    begin_planning(&q, p, g->state, room);
    for (int k = 0; k < h; k++) wanted[k] = g->reference[k] - g->disturbance;
    const int count = build_candidates(&q, wanted, g->u_last, g->remaining, g->planned, resting);
    if (count < 0) {
        refuse_plan(out, HYSTMPC_FAILED, 0);
        return;
    }
    /* At rest most steps hold, and look no further. */
    const int first = resting && count > HYSTMPC_FOLLOWING ? HYSTMPC_FOLLOWING : count;
    /* At rest moves are not those of the reference, but of the estimate's noise. */
    const int of_noise = resting && g->sigma > R(0.0);
    const real rate_weight = by_closeness(p->law->rate_weight, p->law->close_rate_weight, of_noise ? R(0.0) : g->close);
    const hystmpc_task task = {wanted, q.plans + HYSTMPC_INVERTED * h, g->u_last, rate_weight,
                               p->law->angle_low - g->disturbance, p->law->angle_high - g->disturbance, NULL, NULL};
    if (predict_candidates(&q, 0, first)) {
        refuse_plan(out, HYSTMPC_FAILED, 0);
        return;
    }
    judge_hold(p->law->hold, head, g, q.angles + HYSTMPC_HELD * h, h, tolerance);
    const int still = head->holding && motion == h;
    take_cheapest(&q, &task, 0, still ? HYSTMPC_HELD + 1 : first, &best);
    if (!still) {
        if (predict_candidates(&q, first, count)) {
            refuse_plan(out, HYSTMPC_FAILED, 0);
            return;
        }
        take_cheapest(&q, &task, first, count, &best);
    }
    refuse_plan(out, HYSTMPC_OK, 0);
    if (!is_finite(best.cost)) refuse_plan(out, HYSTMPC_NO_PLAN, HYSTMPC_NO_PREDICTION);
    else if (!still) improve_plan(&q, head, g, &task, &best, out, motion);
    if (out->status != HYSTMPC_OK) return;
    out->u = best.commands[0];
    out->source = HYSTMPC_MPC;
    out->planned = h;
}

HYSTMPC_LOCAL int hystmpc_plan_ahead(const hystmpc_problem *p, const real *x, const real *wanted, real u_last,
                                     const real *remaining, int left, real tolerance, hystmpc_plan *best, char *room) {
    const int h = p->law->planner->law->horizon;
    planning q;
    begin_planning(&q, p, x, room_begin(room));
    const int count = build_candidates(&q, wanted, u_last, remaining, left, 0);
    if (count < 0 || predict_candidates(&q, 0, count)) return HYSTMPC_NO_ANSWER;
    const real *const inverted = q.plans + HYSTMPC_INVERTED * h;
    const hystmpc_task task = {wanted, inverted, u_last, p->law->rate_weight, -INFINITE, INFINITE, NULL, NULL};
    take_cheapest(&q, &task, 0, count, best);
    if (!is_finite(best->cost)) return HYSTMPC_NO_PREDICTION;
    int within = 1;
    for (int k = 0; k < h; k++) within &= absolute(q.angles[HYSTMPC_HELD * h + k] - wanted[k]) <= tolerance;
    if (within) {
        copy(q.plans + HYSTMPC_HELD * h, best->commands, h);
        copy(q.angles + HYSTMPC_HELD * h, best->angles, h);
        return 0;
    }
    int64_t draws = 0;
    return hystmpc_improve(q.planner, p->model, x, &task, best, &draws, q.room);
}

#undef PREDICTIVE_CLOSE
