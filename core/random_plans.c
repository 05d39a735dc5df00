/* Planners of random plans: path integral control (Williams et al., T-RO 2018) and the cross-entropy method (Pinneri et
 * al., CoRL 2020), each with a Gauss-Newton step whose Jacobian is fitted to the plans.
 *
 *     u = p + sigma M F w,  w standard normal (m),  M (H, m) the blocks of moves, F (m, m) the noise at their ends
 *
 * The w of m plans in succession are orthogonal, so that m plans cover every direction once. All plans are admissible
 * before they are rolled out. Nothing that is tried makes the best plan worse. */
#include "normals.h"
#include "planner.h"
#include "room.h"
#include "sampling.h"

enum { RANDOM_PARTS = 5, RANDOM_TRIED = RANDOM_PARTS + 1 }; /* of the fitted step, and one plan more */

/* What an improvement works on: N random plans, R with the elites that are kept, H samples, m moves, E elites. */
typedef struct {
    const hystmpc_planner *planner;
    const hystmpc_model *model;
    const hystmpc_task *task;
    const hystmpc_sampling *sampling;
    const real *x;
    int horizon;
    real *normals;               /* (N, m) */
    real *plans, *angles, *costs; /* (R, H), (R, H), (R) */
    real *ordered;               /* (R): costs in order */
    real *tried, *tried_angles;  /* (6, H) */
    real *mean, *deviation;      /* (H): of the next plans of the cross-entropy method */
    real *elites;                /* (E, H) */
    real *program, *fit;         /* numbers of the program of the fitted step, and of the fit */
    int *indices, *order;        /* whole ones of the program; rows of the elites (E) */
    hystmpc_normals generator;
    char *room;                  /* of the model's functions */
} random_work;

static int random_rows(const hystmpc_planner *p) {
    const hystmpc_sampling *const s = p->sampling;
    const int rows = s->samples + (p->kind == HYSTMPC_CROSS_ENTROPY ? s->kept : 0);
    return rows > RANDOM_TRIED ? rows : RANDOM_TRIED;
}

static long random_program(const hystmpc_law *l) {
    return hystmpc_qp_reals(l->moves, hystmpc_program_rows(l), hystmpc_program_slacks(l));
}

/* S F^-1 (H, m), and the room of its fit; see sampling.h. */
static long random_fit(const hystmpc_law *l) {
    return (long)l->horizon * l->moves + (l->moves + 1L) * (l->moves + l->horizon);
}

static long random_indices(const hystmpc_law *l) {
    return 2L * l->moves + hystmpc_program_slacks(l);
}

HYSTMPC_LOCAL long hystmpc_random_bytes(const hystmpc_planner *p, const hystmpc_model *m) {
    const hystmpc_sampling *const s = p->sampling;
    const hystmpc_law *const l = s->fitted;
    const long h = p->law->horizon, rows = random_rows(p), elites = s->elites > 0 ? s->elites : 0;
    return ROOM_LINE + room_for((long)s->samples * s->size) + 2 * room_for(rows * h) +
           2 * room_for(rows) + 2 * room_for(RANDOM_TRIED * h) +
           2 * room_for(h) + room_for(elites * h) +
           room_for(random_program(l)) + room_for(random_fit(l)) +
           room_for(random_indices(l)) + room_for(elites) +
           hystmpc_model_bytes(m, (int)rows, (int)h);
}

static void random_lay_out(random_work *w, char *room) {
    const hystmpc_sampling *const s = w->sampling;
    const hystmpc_law *const l = s->fitted;
    const long h = w->horizon, rows = random_rows(w->planner), elites = s->elites > 0 ? s->elites : 0;
    room = room_begin(room);
    w->normals = room_take(&room, (long)s->samples * s->size);
    w->plans = room_take(&room, rows * h);
    w->angles = room_take(&room, rows * h);
    w->costs = room_take(&room, rows);
    w->ordered = room_take(&room, rows);
    w->tried = room_take(&room, RANDOM_TRIED * h);
    w->tried_angles = room_take(&room, RANDOM_TRIED * h);
    w->mean = room_take(&room, h);
    w->deviation = room_take(&room, h);
    w->elites = room_take(&room, elites * h);
    w->program = room_take(&room, random_program(l));
    w->fit = room_take(&room, random_fit(l));
    w->indices = (int *)(void *)room_take(&room, random_indices(l));
    w->order = (int *)(void *)room_take(&room, elites);
    w->room = room;
}

/* N admissible plans around a mean (H); deviations (N) of each plan, or along (H) of each sample. */
static void random_draw(random_work *w, const real *mean, const real *deviations, int along) {
    const hystmpc_sampling *const s = w->sampling;
    const hystmpc_law *const l = w->planner->law;
    hystmpc_normals_draw(&w->generator, s->samples * s->size, w->normals);
    hystmpc_draw_plans(s->samples, s->size, w->horizon, w->normals, s->shape, mean, deviations, along, l->lower,
                       l->upper, l->reach, w->task->u_last, w->plans);
}

/* Angles and costs of the first plans. Those whose cost is not finite are left out: answers how many remain, or why there
 * is none. */
static int random_predict(const random_work *w, int rows) {
    const int h = w->horizon;
    int count = 0;
    if (hystmpc_model_run(w->model, w->x, rows, h, w->plans, w->angles, w->room)) return HYSTMPC_NO_ANSWER;
    for (int n = 0; n < rows; n++) {
        const real cost = hystmpc_plan_cost(w->planner->law, w->task, w->plans + n * h, w->angles + n * h);
        if (!is_finite(cost)) continue;
        if (count < n) {
            copy(w->plans + n * h, w->plans + count * h, h);
            copy(w->angles + n * h, w->angles + count * h, h);
        }
        w->costs[count++] = cost;
    }
    return count ? count : HYSTMPC_NO_SAMPLE;
}

static void random_take(const random_work *w, const real *commands, const real *angles, real cost,
                        hystmpc_plan *best) {
    if (!(cost < best->cost)) return;
    copy(commands, best->commands, w->horizon);
    copy(angles, best->angles, w->horizon);
    best->cost = cost;
}

/* The best one of the first plans that are tried, made admissible, and the best so far: 0, or why there is none. */
static int random_try(const random_work *w, int count, hystmpc_plan *best) {
    const hystmpc_law *const l = w->planner->law;
    const int h = w->horizon;
    if (count == 0) return 0;
    for (int n = 0; n < count; n++)
        hystmpc_clip_plan(h, l->lower, l->upper, l->reach, w->task->u_last, w->tried + n * h);
    if (hystmpc_model_run(w->model, w->x, count, h, w->tried, w->tried_angles, w->room)) return HYSTMPC_NO_ANSWER;
    for (int n = 0; n < count; n++) {
        const real *const commands = w->tried + n * h, *const angles = w->tried_angles + n * h;
        random_take(w, commands, angles, hystmpc_plan_cost(l, w->task, commands, angles), best);
    }
    return 0;
}

/* Gauss-Newton with a Jacobian fitted to the first plans, see sampling.h: the step from a plan and parts of it (5, H), not
 * yet admissible. Answers how many: none where the program has no solution. */
static int random_fitted(const random_work *w, int count, const hystmpc_plan *around, real *parts) {
    static const real shares[RANDOM_PARTS] = {R(1.0), R(0.6), R(0.35), R(0.2), R(0.1)};
    const hystmpc_law *const l = w->sampling->fitted;
    const int h = w->horizon, m = l->moves;
    real *const columns = w->fit, *const behind = columns + h * m;
    hystmpc_qp q;
    hystmpc_place_qp(&q, m, hystmpc_program_rows(l), hystmpc_program_slacks(l), w->program, w->indices);
    hystmpc_fit_columns(count, h, m, w->plans, w->angles, around->commands, around->angles, l->ends,
                        w->sampling->whitening, behind, columns);
    if (hystmpc_solve_program(&q, l, w->task, around->commands, around->angles, columns, w->planner->changes, parts) < 0)
        return 0;
    hystmpc_deviation(l, q.primal, behind);
    for (int i = 0; i < RANDOM_PARTS; i++)
        for (int k = 0; k < h; k++) parts[i * h + k] = around->commands[k] + shares[i] * behind[k];
    return RANDOM_PARTS;
}

/* The weighted mean of the plans, the fitted step or the cheapest plan, whichever costs least. The mean alone would follow
 * the noise of the disturbance estimate. */
static int random_weigh(random_work *w, hystmpc_plan *best) {
    const hystmpc_sampling *const s = w->sampling;
    const int h = w->horizon;
    int first = 0;
    random_draw(w, best->commands, s->sigmas, 0);
    const int count = random_predict(w, s->samples);
    if (count < 0) return count;
    for (int n = 1; n < count; n++)
        if (w->costs[n] < w->costs[first]) first = n;
    hystmpc_weighted_mean(count, h, w->plans, w->costs, s->temperature, w->ordered, w->tried);
    const int parts = random_fitted(w, count, best, w->tried + h);
    const int answer = random_try(w, 1 + parts, best);
    random_take(w, w->plans + first * h, w->angles + first * h, w->costs[first], best);
    return answer;
}

/* Rows of the cheapest of so many plans, cheapest first, of equal ones the first one first; answers how many. */
static int random_rank(const random_work *w, int count) {
    int ranked = 0;
    for (int n = 0; n < count; n++) {
        int i = ranked;
        while (i > 0 && w->costs[n] < w->costs[w->order[i - 1]]) i--;
        if (i >= w->sampling->elites) continue;
        if (ranked < w->sampling->elites) ranked++;
        for (int j = ranked - 1; j > i; j--) w->order[j] = w->order[j - 1];
        w->order[i] = n;
    }
    return ranked;
}

/* Mean and deviation of the elites in every sample. */
static void random_fit_elites(const random_work *w, int elites) {
    const int h = w->horizon;
    const real count = (real)elites;
    for (int k = 0; k < h; k++) {
        real sum = R(0.0), squares = R(0.0);
        for (int n = 0; n < elites; n++) sum += w->elites[n * h + k];
        const real mean = sum / count;
        for (int n = 0; n < elites; n++) {
            const real off = w->elites[n * h + k] - mean;
            squares += off * off;
        }
        w->mean[k] = mean;
        w->deviation[k] = most(MATH(sqrt)(squares / count), w->sampling->least_sigma);
    }
}

/* One iteration of the cross-entropy method; `kept` counts the elites that take part again. */
static int random_cross(random_work *w, int *kept, hystmpc_plan *best) {
    const hystmpc_sampling *const s = w->sampling;
    const int h = w->horizon;
    random_draw(w, w->mean, w->deviation, 1);
    copy(w->elites, w->plans + s->samples * h, *kept * h);
    const int count = random_predict(w, s->samples + *kept);
    if (count < 0) return count;
    const int elites = random_rank(w, count), first = w->order[0];
    for (int n = 0; n < elites; n++) copy(w->plans + w->order[n] * h, w->elites + n * h, h);
    random_fit_elites(w, elites);
    *kept = s->kept < elites ? s->kept : elites;
    const int parts = random_fitted(w, count, best, w->tried);
    random_take(w, w->plans + first * h, w->angles + first * h, w->costs[first], best);
    return random_try(w, parts, best);
}

static int random_cross_entropy(random_work *w, hystmpc_plan *best) {
    int kept = 0;
    copy(best->commands, w->mean, w->horizon);
    fill(w->deviation, w->sampling->sigma, w->horizon);
    for (int i = 0; i < w->planner->iterations; i++) {
        const int answer = random_cross(w, &kept, best);
        if (answer < 0) return answer;
    }
    copy(w->mean, w->tried, w->horizon);
    return random_try(w, 1, best);
}

static int random_path_integral(random_work *w, hystmpc_plan *best) {
    for (int i = 0; i < w->planner->iterations; i++) {
        const int answer = random_weigh(w, best);
        if (answer < 0) return answer;
    }
    return 0;
}

HYSTMPC_LOCAL int hystmpc_improve_at_random(const hystmpc_planner *p, const hystmpc_model *m, const real *x,
                                            const hystmpc_task *task, hystmpc_plan *best, int64_t *draws, char *room) {
    random_work w;
    w.planner = p;
    w.model = m;
    w.task = task;
    w.sampling = p->sampling;
    w.x = x;
    w.horizon = p->law->horizon;
    random_lay_out(&w, room);
    hystmpc_normals_init(&w.generator, p->sampling->seed, *draws);
    const int answer = p->kind == HYSTMPC_CROSS_ENTROPY ? random_cross_entropy(&w, best) : random_path_integral(&w, best);
    if (answer >= 0) *draws += 1;
    return answer;
}
