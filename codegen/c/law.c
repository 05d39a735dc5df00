/* The predictive law: candidate plans, the hold at a constant reference, the best plan improved. */
#include "internal.h"

enum { HELD = 0, INVERTED = 1, FOLLOWING = 5 };

static const real shares[8] = {R(0.125), R(0.1875), R(0.25), R(0.375), R(0.5), R(0.625), R(0.75), R(1.0)};

/* Limited in rate backwards in time: every move of the plan starts early enough to arrive. */
static void run_ahead(real *commands) {
    for (int k = H - 2; k >= 0; k--)
        commands[k] = clamp(commands[k], commands[k + 1] - HYSTMPC_REACH, commands[k + 1] + HYSTMPC_REACH);
}

/* The first jump of the plan later by half of the samples that it takes at the greatest rate. */
static void postpone_half(real *commands, real u_last) {
    real before = u_last;
    for (int k = 0; k < H; k++) {
        const real jump = absolute(commands[k] - before);
        if (jump > HYSTMPC_REACH * (R(1.0) + HYSTMPC_ROUNDING)) {
            int samples = 0;
            while (samples < 2 * H && (real)samples < jump / HYSTMPC_REACH - HYSTMPC_ROUNDING) samples++; /* rounded up */
            for (int j = k; j < k + samples / 2 && j < H; j++) commands[j] = before;
            return;
        }
        before = commands[k];
    }
}

/* Admissible plans: hold; inverse; inverse ahead of time; half ahead; the last plan; reversals of 2, 4, ... samples at
 * the greatest rate; and where the reference rests small steps. How many there are. */
static int build_candidates(hystmpc_controller *c, const given *g, const real *wanted, int resting) {
    real(*plans)[HYSTMPC_HORIZON] = c->work.plans;
    int count = FOLLOWING;
    fill(plans[HELD], g->u_last, H);
    state_follow(&c->work, &g->state, wanted, g->u_last, plans[2], plans[INVERTED]);
    copy(plans[2], plans[3], H);
    for (int k = 0; k < H; k++)
        plans[4][k] = c->planned ? c->plan[k < c->planned ? k : c->planned - 1] : plans[INVERTED][k];
    postpone_half(plans[3], g->u_last);
    run_ahead(plans[2]);
    run_ahead(plans[3]);
    for (int sign = 1; sign >= -1; sign -= 2) {
        for (int length = 2; length <= (H / 2 > 2 ? H / 2 : 2); length *= 2, count++)
            for (int k = 0; k < H; k++)
                plans[count][k] = g->u_last + (real)sign * (HYSTMPC_REACH * (real)(k + 1 < length ? k + 1 : length));
    }
    if (resting) {
        for (int sign = 1; sign >= -1; sign -= 2)
            for (int i = 0; i < 8; i++, count++)
                fill(plans[count], g->u_last + (real)sign * (HYSTMPC_REACH * shares[i]), H);
    }
    for (int n = 0; n < count; n++) clip_plan(plans[n], g->u_last);
    return count;
}

static real farthest(const real *angles, int count, real shift, real target) {
    real found = R(0.0);
    for (int k = 0; k < count; k++) {
        const real off = absolute(angles[k] + shift - target);
        if (!(off <= found)) found = off; /* not-a-number stays */
        if (off != off) break;
    }
    return found;
}

/* Whether to hold now: the reference has come to rest, and the held command keeps the angle close. */
static void judge_hold(hystmpc_controller *c, const given *g, const real *held) {
    const int held_before = c->holding;
    const real now = g->reference[0];
    const int lead = HYSTMPC_HOLD_LEAD < H ? HYSTMPC_HOLD_LEAD : H;
    c->holding = 0;
    if (!(absolute(now - c->hold_target) <= HYSTMPC_HOLD_TOLERANCE) ||
        (HYSTMPC_HOLD_LEAD > 1 && farthest(g->reference, lead, R(0.0), c->hold_target) > HYSTMPC_HOLD_TOLERANCE)) {
        c->constant = 0;
        c->hold_target = now;
        return;
    }
    if (c->constant < HYSTMPC_MOST_SAMPLES) c->constant++;
    const real waited = least((real)(c->constant / HYSTMPC_HOLD_PATIENCE), HYSTMPC_LEAVE_SIGMAS);
    const real more = held_before ? HYSTMPC_LEAVE_SIGMAS * g->sigma + HYSTMPC_HOLD_STEP : waited * g->sigma;
    c->holding = farthest(held, H, g->disturbance, c->hold_target) <= HYSTMPC_HOLD_TOLERANCE + more;
}

/* In a hold a correction as small as the error asks for, so that it meets the measurement before it is too far. */
static int limit_correction(const hystmpc_controller *c, real *commands, real u_last, real error) {
    if (!(HYSTMPC_HOLD_SETTLE > 0 && c->constant > HYSTMPC_HOLD_SETTLE_AFTER && HYSTMPC_SLOPE > R(0.0))) return 0;
    for (int k = 0; k < H; k++) {
        const real reach = error / (HYSTMPC_SLOPE * (real)HYSTMPC_HOLD_SETTLE) * (real)(k + 1);
        commands[k] = clamp(commands[k], u_last - reach, u_last + reach);
    }
    clip_plan(commands, u_last);
    return 1;
}

HYSTMPC_LOCAL void init_predictive(hystmpc_controller *c) {
    c->holding = c->constant = 0;
    c->hold_target = (real)NAN;
}

/* Cheapest of the candidates from `first` to `last`, if it is cheaper than the best so far. */
static void cheapest(hystmpc_controller *c, const problem *p, int first, int last, plan *best) {
    for (int n = first; n < last; n++) {
        const real cost = plan_cost(p, c->work.plans[n], c->work.angles[n]);
        if (n > 0 && !(cost < best->cost)) continue;
        copy(c->work.plans[n], best->commands, H);
        copy(c->work.angles[n], best->angles, H);
        best->cost = cost;
    }
}

/* The wanted command and the plan behind it. What is remembered changes only where there is a proposal. */
HYSTMPC_LOCAL void propose_predictive(hystmpc_controller *c, const given *g, proposal *out) {
    real wanted[HYSTMPC_HORIZON];
    const int resting = c->constant > 0, holding = c->holding, constant = c->constant;
    const real hold_target = c->hold_target;
    for (int k = 0; k < H; k++) wanted[k] = g->reference[k] - g->disturbance;
    const int count = build_candidates(c, g, wanted, resting), first = resting ? FOLLOWING : count;
    problem p;
    p.state = &g->state;
    p.reference = wanted;
    p.feedforward = c->work.plans[INVERTED];
    p.u_last = g->u_last;
    p.low = HYSTMPC_ANGLE_LOW - g->disturbance;
    p.high = HYSTMPC_ANGLE_HIGH - g->disturbance;
    state_run_plans(&c->work, &g->state, c->work.plans, first, c->work.angles);
    judge_hold(c, g, c->work.angles[HELD]);
    plan best;
    cheapest(c, &p, 0, c->holding ? 1 : first, &best);
    if (!c->holding) {
        state_run_plans(&c->work, &g->state, c->work.plans + first, count - first, c->work.angles + first);
        cheapest(c, &p, first, count, &best);
    }
    out->status = is_finite(best.cost) ? HYSTMPC_OK : HYSTMPC_NO_PLAN;
    if (out->status == HYSTMPC_OK && !c->holding) {
        const real error = farthest(c->work.angles[HELD], H, g->disturbance, c->hold_target);
        out->status = improve(&c->work, &p, &best);
        if (out->status == HYSTMPC_OK && limit_correction(c, best.commands, g->u_last, error))
            state_run(&g->state, best.commands, best.angles);
    }
    if (out->status != HYSTMPC_OK) {
        c->holding = holding;
        c->constant = constant;
        c->hold_target = hold_target;
        return;
    }
    out->u = best.commands[0];
    out->source = HYSTMPC_MPC;
    out->planned = H;
    copy(best.commands, out->commands, H);
    copy(best.angles, out->angles, H);
}
