/* Sequential quadratic programming along the best plan: linearise, solve, search along the answer. The nonlinear cost
 * guards every step, so that a kink of a play under the linearisation does no harm. */
#include "planner.h"

#include "room.h"

enum { PLANNER_LEARNED_ROUNDS = 2 }; /* at least, with a learned part: candidates of the model's inverse are far off */

/* A step is searched no further where the cost falls by this share of what the linearisation foresees. */
static const real planner_kept = R(0.9);

/* What an improvement works on; H samples, m moves. */
typedef struct {
    const hystmpc_planner *planner;
    const hystmpc_model *model;
    const hystmpc_task *task;
    const real *x;
    real *jacobian; /* (H, H) [deg per command unit] */
    real *angles;   /* (H): of the linearisation; (3, H): of parts of a step */
    real *whole;    /* (H + 1): the plan after the solution, and its foreseen cost */
    real *start;    /* (H): the plan before */
    real *parts;    /* (3, H): of the way between both */
    real *program;  /* numbers of `hystmpc_step_plan`, and the whole ones */
    int *indices;
    char *room;     /* of the model's functions */
} planner_work;

static long planner_program(const hystmpc_law *l) {
    const int rows = hystmpc_program_rows(l), slacks = hystmpc_program_slacks(l);
    return hystmpc_qp_reals(l->moves, rows, slacks) + (long)l->horizon * l->moves;
}

static long planner_indices(const hystmpc_law *l) {
    return 2L * l->moves + hystmpc_program_slacks(l);
}

static int planner_is_random(const hystmpc_planner *p) {
    return p->kind == HYSTMPC_PATH_INTEGRAL || p->kind == HYSTMPC_CROSS_ENTROPY;
}

long hystmpc_planner_bytes(const void *planner, const void *model) {
    const hystmpc_planner *const p = planner;
    const hystmpc_law *const l = p->law;
    const long h = l->horizon;
    if (planner_is_random(p)) return hystmpc_random_bytes(p, model);
    return ROOM_LINE + room_for(h * h) + 2 * room_for(HYSTMPC_SHARES * h) +
           room_for(h + 1) + room_for(h) + room_for(planner_program(l)) +
           room_for(planner_indices(l)) + hystmpc_model_bytes(model, HYSTMPC_SHARES, (int)h);
}

static void planner_lay_out(planner_work *w, char *room) {
    const hystmpc_law *const l = w->planner->law;
    const long h = l->horizon;
    room = room_begin(room);
    w->jacobian = room_take(&room, h * h);
    w->angles = room_take(&room, HYSTMPC_SHARES * h);
    w->parts = room_take(&room, HYSTMPC_SHARES * h);
    w->whole = room_take(&room, h + 1);
    w->start = room_take(&room, h);
    w->program = room_take(&room, planner_program(l));
    w->indices = (int *)(void *)room_take(&room, planner_indices(l));
    w->room = room;
}

/* The cheaper one of the best plan and another; answers the cost of that. */
static real planner_try(const planner_work *w, const real *commands, const real *angles, hystmpc_plan *best) {
    const int samples = w->planner->law->horizon;
    const real cost = hystmpc_plan_cost(w->planner->law, w->task, commands, angles);
    if (cost < best->cost) {
        copy(commands, best->commands, samples);
        copy(angles, best->angles, samples);
        best->cost = cost;
    }
    return cost;
}

/* The plan after the solution of the program around a plan, with its foreseen cost: 0, 1, or why there is none. */
static int planner_step(const planner_work *w, const hystmpc_plan *around) {
    const hystmpc_planner *const p = w->planner;
    const hystmpc_task *const t = w->task;
    const int samples = p->law->horizon;
    const real scalars[4] = {t->u_last, t->rate_weight, t->low, t->high};
    fill(w->jacobian, R(0.0), samples * samples); /* its upper part is left alone */
    if (hystmpc_model_linearise(w->model, w->x, samples, around->commands, w->angles, w->jacobian, w->room))
        return HYSTMPC_NO_ANSWER;
    if (p->kind == HYSTMPC_SOLVED)
        return p->solve(t->reference, t->feedforward, scalars, w->jacobian, around->commands, around->angles, w->whole);
    const int answer = hystmpc_step_plan(p->law, t, w->jacobian, around->commands, around->angles, p->changes,
                                         w->program, w->indices, w->whole, w->whole + samples);
    return answer < 0 ? answer : 0;
}

/* The whole step, and where the cost falls by clearly less than foreseen, parts of it too: 0, or why there is none. */
static int planner_search(const planner_work *w, hystmpc_plan *best) {
    const hystmpc_law *const l = w->planner->law;
    const int samples = l->horizon;
    const real before = best->cost, foreseen = w->whole[samples];
    copy(best->commands, w->start, samples);
    if (hystmpc_model_run(w->model, w->x, 1, samples, w->whole, w->angles, w->room)) return HYSTMPC_NO_ANSWER;
    const real cost = planner_try(w, w->whole, w->angles, best);
    if (before - cost >= planner_kept * (before - foreseen)) return 0; /* not-a-number: look further */
    hystmpc_part_plans(l, w->start, w->whole, w->task->u_last, w->parts);
    if (hystmpc_model_run(w->model, w->x, HYSTMPC_SHARES, samples, w->parts, w->angles, w->room))
        return HYSTMPC_NO_ANSWER;
    for (int i = 0; i < HYSTMPC_SHARES; i++)
        (void)planner_try(w, w->parts + i * samples, w->angles + i * samples, best);
    return 0;
}

int hystmpc_improve(const void *planner, const void *model, const real *x, const void *task, void *best,
                    int64_t *draws, char *room) {
    const hystmpc_planner *const p = planner;
    planner_work w = {p, model, task, x, 0, 0, 0, 0, 0, 0, 0, 0};
    int answer = 0, rounds = p->iterations;
    if (planner_is_random(p)) return hystmpc_improve_at_random(p, model, x, task, best, draws, room);
    if (rounds < PLANNER_LEARNED_ROUNDS && hystmpc_model_acts(model, x)) rounds = PLANNER_LEARNED_ROUNDS;
    planner_lay_out(&w, room);
    for (int round = 0; round < rounds && answer >= 0; round++) {
        const real before = ((const hystmpc_plan *)best)->cost;
        answer = planner_step(&w, best);
        if (answer >= 0 && planner_search(&w, best)) answer = HYSTMPC_NO_ANSWER;
        if (!(((const hystmpc_plan *)best)->cost < before)) break; /* around the same plan a round is the same */
    }
    return answer;
}
