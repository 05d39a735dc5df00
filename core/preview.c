/* Inverses of predictors: for one sample, and along a preview within limits of command and rate; see predictor.h. */
#include "linear.h"
#include "moves.h"
#include "predictor.h"
#include "room.h"

static long preview_command_bytes(const hystmpc_inverse *v) {
    while (v->kind == HYSTMPC_COMPANION || v->kind == HYSTMPC_DRIVEN) v = v->inner;
    return ROOM_LINE + (v->kind == HYSTMPC_EXACT ? hystmpc_chain_single_bytes(v->predictor->chain) : 0L);
}

int hystmpc_inverse_command(const void *inverse, const real *x, int states, real theta, real u_last, real *u,
                            char *room) {
    const hystmpc_inverse *const v = inverse;
    switch (v->kind) {
    case HYSTMPC_EXACT:
        *u = hystmpc_chain_command_for(v->predictor->chain, v->predictor->kept, x, theta, v->low, v->high, u_last,
                                       room_begin(room));
        return 0;
    case HYSTMPC_COMPANION: {
        const hystmpc_predictor *const first = v->predictor->first, *const second = v->predictor->second;
        const real wanted = theta + x[v->predictor->states - 1] - x[first->states];
        return hystmpc_inverse_command(v->inner, x + first->states + 1, second->states, wanted, u_last, u, room);
    }
    case HYSTMPC_DRIVEN:
        x += v->front ? v->front->states : 0;
        return hystmpc_inverse_command(v->inner, x, v->predictor->states, theta, u_last, u, room);
    default: return v->outside->command(x, states, theta, u_last, u);
    }
}

/* The exact inverse whose chain runs along a preview by itself, or beside a network; null: sample by sample. */
static const hystmpc_inverse *preview_at_once(const hystmpc_inverse *v) {
    if (v->kind == HYSTMPC_EXACT) return v;
    if (v->kind != HYSTMPC_COMPANION || v->inner->kind != HYSTMPC_EXACT) return NULL;
    return v->predictor->first->kind == HYSTMPC_RECURRENT ? v->inner : NULL;
}

static const hystmpc_network *preview_network(const hystmpc_inverse *v) {
    return v->kind == HYSTMPC_COMPANION ? v->predictor->first->network : NULL;
}

static long preview_driven_bytes(const hystmpc_inverse *v, int samples) {
    const long square = (long)samples * samples;
    long below = longer(hystmpc_predictor_bytes(v->predictor, 1, 1),
                        hystmpc_inverse_bytes(v->inner, v->predictor, samples));
    const hystmpc_predictor *const drives[2] = {v->front, v->back};
    for (int n = 0; n < 2; n++)
        if (drives[n]) {
            below = longer(below, hystmpc_lead_drive_bytes(drives[n]->chain, samples));
            below = longer(below, hystmpc_predictor_bytes(drives[n], 1, samples));
        }
    return below + room_for(v->predictor->states) + room_for(square) + 4 * room_for(samples) + room_for(2L * samples);
}

long hystmpc_inverse_bytes(const void *inverse, const void *predictor, int samples) {
    const hystmpc_inverse *const v = inverse, *const exact = preview_at_once(v);
    const hystmpc_predictor *const p = predictor;
    const long command = preview_command_bytes(v);
    if (exact)
        return ROOM_LINE + longer(command, hystmpc_follow_bytes(exact->predictor->chain, preview_network(v)));
    if (v->kind == HYSTMPC_DRIVEN) return ROOM_LINE + longer(command, preview_driven_bytes(v, samples));
    return ROOM_LINE + room_for(p->states) + longer(command, hystmpc_predictor_bytes(p, 1, 1));
}

/* A preview: from the state x, along the angles `wanted` (H), under the bounds. */
typedef struct {
    const hystmpc_inverse *inverse;
    const hystmpc_predictor *predictor;
    const real *x, *wanted;
    int samples;
    real u_last, low, high;
} preview_task;

/* Commands (H), each from the state after those before it, one call of inverse and model a sample. */
static int preview_step_by_step(const preview_task *t, real reach, real *plan, real *state, char *room) {
    real last = t->u_last;
    copy(t->x, state, t->predictor->states);
    for (int k = 0; k < t->samples; k++) {
        real u = last, theta;
        int failed = hystmpc_inverse_command(t->inverse, state, t->predictor->states, t->wanted[k], last, &u, room);
        if (failed) return failed;
        u = clamp(is_finite(u) ? u : last, t->low, t->high);
        last = clamp(u, last - reach, last + reach);
        failed = hystmpc_predictor_advance(t->predictor, state, last, &theta, room);
        if (failed) return failed;
        plan[k] = last;
    }
    return 0;
}

/* Row 0 without the rate limit; row 1 the same where it keeps the limit, else sample by sample with it. */
static int preview_any(const preview_task *t, real reach, real *plans, char *room) {
    real *const state = room_take(&room, t->predictor->states), last = t->u_last;
    const int failed = preview_step_by_step(t, (real)INFINITY, plans, state, room);
    if (failed) return failed;
    for (int k = 0; k < t->samples; last = plans[k++])
        if (!(absolute(plans[k] - last) <= reach))
            return preview_step_by_step(t, reach, plans + t->samples, state, room);
    copy(plans, plans + t->samples, t->samples);
    return 0;
}

/* Inputs (H) of a drive in the state x whose outputs come closest to `wanted` (H). */
static void preview_lead(const hystmpc_predictor *drive, const real *x, const real *wanted, int samples, real u_last,
                         real reach, real *inputs, real *outputs, char *room) {
    hystmpc_lead_drive(drive->chain, drive->kept, x, wanted, samples, u_last, reach, inputs, outputs, room);
}

/* The travel within the rate limit backwards in time, so that a jump arrives when it has to; whether that changes it. */
static int preview_arrive(int samples, real reach, real *travel) {
    int changed = 0;
    for (int k = samples - 2; k >= 0; k--) {
        const real here = clamp(travel[k], travel[k + 1] - reach, travel[k + 1] + reach);
        changed |= here != travel[k];
        travel[k] = here;
    }
    return changed;
}

/* The travel within the rate limit forwards in time, so that a jump departs no earlier than it has to. */
static void preview_depart(int samples, real reach, real last, real *travel) {
    for (int k = 0; k < samples; k++) last = travel[k] = clamp(travel[k], last - reach, last + reach);
}

/* With dynamics before and behind the model: first the travel is planned, then the commands whose drive follows it
 * within the rate limit. A jump is spread to either side in row 1, which follows the travel best; in row 0 it arrives in
 * time, which crosses a dead band best. */
static int preview_driven(const preview_task *t, real reach, real *plans, char *room) {
    const hystmpc_inverse *const v = t->inverse;
    const hystmpc_predictor *const front = v->front, *const inner = v->predictor;
    const int samples = t->samples;
    const real *const behind = t->x + (front ? front->states : 0), *wanted = t->wanted;
    real *const middle = room_take(&room, inner->states), *const travel = room_take(&room, samples);
    real *const inputs = room_take(&room, samples), *const outputs = room_take(&room, samples);
    real *const held = room_take(&room, samples), *const free_plan = room_take(&room, 2L * samples);
    real *const response = room_take(&room, (long)samples * samples), last = t->u_last;
    int first = 0, failed;
    copy(behind, middle, inner->states);
    if (v->back) {
        const real *const state = behind + inner->states;
        preview_lead(v->back, state, wanted, samples, wanted[0], (real)INFINITY, inputs, outputs, room);
        wanted = inputs;
    }
    if (front) {
        fill(held, t->u_last, samples);
        failed = hystmpc_predictor_linearise(front, t->x, samples, held, travel, response, room);
        if (failed) return failed;
        first = hystmpc_first_acting(response, samples);
        for (int k = 0; k < first; k++) {
            real theta;
            failed = hystmpc_predictor_advance(inner, middle, travel[k], &theta, room);
            if (failed) return failed;
            last = travel[k];
        }
    }
    fill(plans, t->u_last, 2 * samples);
    if (first >= samples) return 0;
    const real bounds[3] = {t->low, t->high, (real)INFINITY};
    failed = hystmpc_inverse_follow(v->inner, inner, middle, wanted + first, samples - first, last, bounds, free_plan,
                                    room);
    if (failed) return failed;
    copy(free_plan, travel + first, samples - first);
    if (!front) copy(travel, plans, samples);
    else {
        preview_depart(samples - first, reach, last, travel + first);
        preview_lead(front, t->x, travel, samples, t->u_last, reach, plans, outputs, room);
    }
    copy(plans, plans + samples, samples);
    copy(free_plan, travel + first, samples - first);
    if (front && preview_arrive(samples - first, reach, travel + first))
        preview_lead(front, t->x, travel, samples, t->u_last, reach, plans, outputs, room);
    for (int k = 0; k < 2 * samples; k++) plans[k] = clamp(plans[k], t->low, t->high);
    return 0;
}

int hystmpc_inverse_follow(const void *inverse, const void *predictor, const real *x, const real *wanted, int samples,
                           real u_last, const real *bounds, real *plans, char *room) {
    const hystmpc_inverse *const v = inverse, *const exact = preview_at_once(v);
    const hystmpc_predictor *const p = predictor;
    const preview_task task = {v, p, x, wanted, samples, u_last, bounds[0], bounds[1]};
    room = room_begin(room);
    if (samples < 1) return 0;
    if (!all_finite(x, p->states)) { /* the bounds of a network's gates would hide it */
        fill(plans, u_last, 2 * samples);
        return 0;
    }
    if (v->kind == HYSTMPC_DRIVEN) return preview_driven(&task, bounds[2], plans, room);
    if (!exact) return preview_any(&task, bounds[2], plans, room);
    const real inverted[2] = {exact->low, exact->high};
    hystmpc_follow(exact->predictor->chain, exact->predictor->kept, preview_network(v), x, wanted, samples,
                   u_last, bounds, inverted, plans, room);
    return 0;
}
