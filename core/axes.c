/* Two axes: separate proposals, the commands that pull by both, one program where their limits bind. See axes.h. */
#include "axes.h"
#include "room.h"

#include <string.h>

/* Shares of a command's greatest change: by so much limits may move a command that is still the one proposed, and within
 * this it is the one sent last. */
#if HYSTMPC_SINGLE
static const real axes_grain = R(1e-3), axes_same = R(1e-4);
#else
static const real axes_grain = R(1e-6), axes_same = R(1e-8);
#endif

enum {
    AXES_CROSS_STATES = 2 + 4 * HYSTMPC_CROSS_MOST + 2 * HYSTMPC_CROSS_LATE,
    AXES_SHARES = 3 /* the whole way to the plans of a program, half of it, a quarter */
};

/* One axis in a call. */
typedef struct {
    const hystmpc_problem *p;
    hystmpc_memory m;
    hystmpc_proposal out;
    char *memory;
} axes_one;

typedef struct {
    const hystmpc_axes *a;
    real *last;  /* u sent last (n) */
    real *past;  /* the shared friction c (HYSTMPC_PAST, 2), the newest first */
    real *cross; /* its state */
    axes_one axis[HYSTMPC_AXES];
    int horizon;
} axes_call;

/* A joint program: H samples, n commands. */
typedef struct {
    real *program; /* numbers of `hystmpc_step_plan`, and the whole ones */
    int *whole;
    real *slopes;   /* of y_i + c_i by the travel of axis a (2, 2, H, H) */
    real *rub;      /* the shared friction c along the plans (2, H) */
    real *bends;    /* room for its derivatives */
    real *jacobian; /* (2, H, n, H) */
    real *asked;    /* moves that the reference asks for (n, H) */
    real *better;   /* (n H + 1): other plans, and their foreseen cost */
    real *proposed; /* (n H): those of the axes, where what is left of the last ones is cheaper */
    real *travels, *y, *theta, *wanted; /* (2, H) */
    real *state[HYSTMPC_AXES];
    char *room; /* of the models' functions */
} axes_joint;

static const hystmpc_problem *axes_problem(const hystmpc_axes *a, int i) { return i ? a->second : a->first; }

/* Whether both have accepted a start. */
static int axes_started(const axes_call *c) {
    return c->axis[0].m.head->mark == HYSTMPC_MARK && c->axis[1].m.head->mark == HYSTMPC_MARK;
}

static int axes_cross_states(const hystmpc_axes *a) { return a->cross ? hystmpc_cross_states(a->cross) : 0; }

static long axes_head_bytes(const hystmpc_axes *a) {
    const int numbers = a->commands + (a->cross ? HYSTMPC_AXES * HYSTMPC_PAST : 0) + axes_cross_states(a);
    return (long)sizeof(real) * ((numbers + 1) / 2 * 2);
}

long hystmpc_axes_bytes(const void *axes) {
    const hystmpc_axes *const a = axes;
    return axes_head_bytes(a) + hystmpc_memory_bytes(a->first) + hystmpc_memory_bytes(a->second);
}

static void axes_open(const hystmpc_axes *a, char *memory, axes_call *c) {
    memset(c, 0, sizeof *c);
    c->a = a;
    c->last = (real *)(void *)memory;
    c->past = c->last + a->commands;
    c->cross = c->past + HYSTMPC_AXES * HYSTMPC_PAST;
    memory += axes_head_bytes(a);
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        c->axis[i].p = axes_problem(a, i);
        c->axis[i].memory = memory;
        hystmpc_memory_at(c->axis[i].p, memory, &c->axis[i].m);
        memory += hystmpc_memory_bytes(c->axis[i].p);
    }
    c->horizon = a->first->law->horizon;
}

/* Angles of a proposal: of the plan, or those of commands on their way. */
static int axes_foretold(const hystmpc_axes *a) {
    const int delay = a->first->sensing->delay, h = a->first->law->horizon;
    return h > delay ? h : delay + 1;
}

/* Numbers for a joint program: slopes of each axis and of all, plans, angles, and those of `hystmpc_step_plan`. */
static long axes_program(const hystmpc_law *l) {
    const int n = hystmpc_program_unknowns(l), rows = hystmpc_program_rows(l), slacks = hystmpc_program_slacks(l);
    return hystmpc_qp_reals(n, rows, slacks) + (long)hystmpc_program_angles(l) * n;
}

/* to_i = sum_j by (i, j) x_j over rows of numbers; what has no share is not read, and may be not-a-number. */
static void axes_map(const real *by, int rows, int columns, const real *x, int apart, real *to, int to_apart) {
    for (int i = 0; i < rows; i++) {
        real sum = R(0.0);
        for (int j = 0; j < columns; j++)
            if (by[i * columns + j] != R(0.0)) sum += by[i * columns + j] * x[j * apart];
        to[i * to_apart] = sum;
    }
}

/* Travels w (2) of the axes by commands (n), and the commands for travels. */
static void axes_travels(const hystmpc_axes *a, const real *u, int apart, real *w, int w_apart) {
    axes_map(a->mix, HYSTMPC_AXES, a->commands, u, apart, w, w_apart);
}

static void axes_commands(const hystmpc_axes *a, const real *w, int apart, real *u, int u_apart) {
    real off[HYSTMPC_AXES];
    axes_travels(a, a->rest, 1, off, 1);
    for (int i = 0; i < HYSTMPC_AXES; i++) off[i] = w[i * apart] - off[i];
    axes_map(a->unmix, a->commands, HYSTMPC_AXES, off, 1, u, u_apart);
    for (int j = 0; j < a->commands; j++) u[j * u_apart] += a->rest[j];
}

/* The nearest admissible commands (n) behind others, in place; answers their greatest change, in shares of the greatest
 * move. Where one is no number the last one stays. */
static real axes_limit(const hystmpc_axes *a, const real *before, int before_apart, real *u, int apart) {
    real off = R(0.0);
    for (int j = 0; j < a->commands; j++) {
        const real at = clamp(before[j * before_apart], a->lower[j], a->upper[j]), asked = u[j * apart];
        const real low = most(a->lower[j], at - a->reach[j]), high = least(a->upper[j], at + a->reach[j]);
        u[j * apart] = clamp(is_finite(asked) ? asked : at, low, high);
        const real moved = is_finite(asked) ? absolute(u[j * apart] - asked) / a->reach[j] : INFINITE;
        off = most(off, moved);
    }
    return off;
}

/* Angles y (2) by measured angles theta (2): not-a-number where one is too large to be an angle. */
static void axes_seen(const hystmpc_axes *a, const real *angles_deg, real *y) {
    real seen[HYSTMPC_AXES];
    for (int i = 0; i < HYSTMPC_AXES; i++) seen[i] = hystmpc_usable_angle(angles_deg[i]);
    axes_map(a->unframe, HYSTMPC_AXES, HYSTMPC_AXES, seen, 1, y, 1);
}

/* The nearest one of the remembered samples. */
static int axes_ago(int age) { return age < 0 ? 0 : age < HYSTMPC_PAST ? age : HYSTMPC_PAST - 1; }

/* Angles y (2) of the axes by measured ones, `age` samples ago, without the shared friction then. */
static void axes_measured(const axes_call *c, const real *angles_deg, int age, real *y) {
    axes_seen(c->a, angles_deg, y);
    if (!c->a->cross) return;
    for (int i = 0; i < HYSTMPC_AXES; i++) y[i] -= c->past[HYSTMPC_AXES * axes_ago(age) + i];
}

/* The shared friction of one sample of travels w (2). */
static void axes_rub(const axes_call *c, const real *w) {
    if (!c->a->cross) return;
    for (int k = HYSTMPC_AXES * HYSTMPC_PAST - 1; k >= HYSTMPC_AXES; k--) c->past[k] = c->past[k - HYSTMPC_AXES];
    hystmpc_cross_run(c->a->cross, 1, w, c->cross, c->past);
}

/* The shared friction (2, S) at the ends of the coming samples: of commands on their way, then along what is left of both
 * plans, and a hold behind it. */
static void axes_foresee(const axes_call *c, int samples, real *travels, real *shared) {
    real state[AXES_CROSS_STATES];
    const int delay = c->a->first->sensing->delay;
    fill(shared, R(0.0), HYSTMPC_AXES * samples);
    if (!c->a->cross) return;
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        const hystmpc_memory *const m = &c->axis[i].m;
        const int left = m->head->planned;
        for (int k = 0; k < samples; k++)
            travels[i * samples + k] = left ? m->plan[k < left ? k : left - 1] : m->observed.now.known->command;
    }
    copy(c->cross, state, axes_cross_states(c->a));
    hystmpc_cross_run(c->a->cross, samples, travels, state, shared);
    for (int i = 0; i < HYSTMPC_AXES && delay; i++) {
        real *const one = shared + i * samples;
        for (int k = samples - 1; k >= 0; k--)
            one[k] = k >= delay ? one[k - delay] : c->past[HYSTMPC_AXES * axes_ago(delay - 1 - k) + i];
    }
}

/* What both axes share, c (2), in a rest at travels w (2): static coupling, since its friction is at rest as well. */
static void axes_shared_at_rest(const hystmpc_axes *a, const real *w, real *shared) {
    real state[2 + 4 * HYSTMPC_CROSS_MOST + 2 * HYSTMPC_CROSS_LATE];
    hystmpc_cross_rest(a->cross, w, state);
    hystmpc_cross_run(a->cross, 1, w, state, shared);
}

void hystmpc_axes_begin(const void *axes, char *memory, const real *commands) {
    const hystmpc_axes *const a = axes;
    axes_call c;
    real w[HYSTMPC_AXES];
    axes_open(a, memory, &c);
    copy(commands, c.last, a->commands);
    axes_travels(a, commands, 1, w, 1);
    if (!a->cross) return;
    axes_shared_at_rest(a, w, c.past);
    for (int k = 1; k < HYSTMPC_PAST; k++) copy(c.past, c.past + HYSTMPC_AXES * k, HYSTMPC_AXES);
    hystmpc_cross_rest(a->cross, w, c.cross);
}

void hystmpc_axes_at(const void *axes, const real *angles_deg, const real *commands, real *y, real *w) {
    const hystmpc_axes *const a = axes;
    axes_seen(a, angles_deg, y);
    axes_travels(a, commands, 1, w, 1);
    if (a->cross) {
        real shared[HYSTMPC_AXES];
        axes_shared_at_rest(a, w, shared);
        for (int i = 0; i < HYSTMPC_AXES; i++) y[i] -= is_finite(shared[i]) ? shared[i] : R(0.0); /* of commands that are none */
    }
    for (int i = 0; i < HYSTMPC_AXES; i++) w[i] = clamp(w[i], axes_problem(a, i)->lower, axes_problem(a, i)->upper);
}

/* After a start that was refused: stopped at the commands sent last, or not started at those of the start. */
static void axes_refuse(axes_call *c, char *memory, const real *commands, int before) {
    const hystmpc_axes *const a = c->a;
    for (int j = 0; j < a->commands && !before; j++)
        c->last[j] = clamp(is_finite(commands[j]) ? commands[j] : a->rest[j], a->lower[j], a->upper[j]);
    hystmpc_axes_held(a, memory, c->last);
    hystmpc_axes_stop(a, memory);
}

int hystmpc_axes_init(const void *axes, char *memory, const real *x, const real *angles_deg, const real *commands,
                      char *room) {
    const hystmpc_axes *const a = axes;
    axes_call c;
    real y[HYSTMPC_AXES], w[HYSTMPC_AXES];
    int answer = HYSTMPC_STARTED;
    axes_open(a, memory, &c);
    const int before = axes_started(&c);
    hystmpc_axes_at(a, angles_deg, commands, y, w);
    for (int j = 0; j < a->commands; j++)
        if (!(a->lower[j] <= commands[j] && commands[j] <= a->upper[j])) answer = HYSTMPC_BAD_COMMAND;
    for (int i = 0; i < HYSTMPC_AXES; i++)
        if (!is_finite(hystmpc_usable_angle(y[i]))) answer = HYSTMPC_BAD_ANGLE;
    for (int i = 0; i < HYSTMPC_AXES && answer == HYSTMPC_STARTED; i++) {
        const hystmpc_problem *const p = c.axis[i].p;
        answer = hystmpc_controller_init(p, c.axis[i].memory, x, y[i], w[i], room);
        if (p->model) x += p->model->predictor->states;
    }
    if (answer == HYSTMPC_STARTED) hystmpc_axes_begin(a, memory, commands);
    else axes_refuse(&c, memory, commands, before);
    return answer;
}

/* Commands (n) for travels w (2) behind others: those, where they pull so already. */
static void axes_pull(const hystmpc_axes *a, const real *w, const real *before, int before_apart, real *u, int apart) {
    real pulled[HYSTMPC_AXES];
    int same = 1;
    axes_travels(a, before, before_apart, pulled, 1);
    for (int i = 0; i < HYSTMPC_AXES; i++) same &= absolute(w[i] - pulled[i]) <= axes_same * axes_problem(a, i)->reach;
    if (!same) axes_commands(a, w, 1, u, apart);
    for (int j = 0; same && j < a->commands; j++) u[j * apart] = before[j * before_apart];
}

/* Whether both axes plan over the whole horizon, so that their plans can be weighed. */
static int axes_plan(const axes_call *c) {
    int plan = c->a->law != NULL;
    for (int i = 0; i < HYSTMPC_AXES; i++)
        plan &= c->axis[i].out.source == HYSTMPC_MPC && c->axis[i].out.status == HYSTMPC_OK &&
                c->axis[i].out.planned == c->horizon;
    return plan;
}

/* Admissible commands (n, H) along travels, of the axes `apart` numbers from each other; answers by how much the limits move
 * them. */
static real axes_admit(const axes_call *c, const real *travels, int apart, real *plans) {
    const int h = c->horizon;
    real off = R(0.0);
    for (int k = 0; k < h; k++) {
        const real w[HYSTMPC_AXES] = {travels[k], travels[apart + k]};
        const real *const before = k ? plans + k - 1 : c->last;
        axes_pull(c->a, w, before, k ? h : 1, plans + k, h);
        off = most(off, axes_limit(c->a, before, k ? h : 1, plans + k, h));
    }
    return off;
}

/* Travels (2, H) of commands (n, H), and no shared friction yet. */
static void axes_follow(const axes_call *c, const real *plans, axes_joint *q) {
    for (int k = 0; k < c->horizon; k++) axes_travels(c->a, plans + k, c->horizon, q->travels + k, c->horizon);
    fill(q->rub, R(0.0), HYSTMPC_AXES * c->horizon);
}

/* Angles theta (2, H) of y and of the shared friction. */
static void axes_sum(const axes_call *c, axes_joint *q) {
    const int h = c->horizon;
    for (int k = 0; k < h; k++) {
        const real y[HYSTMPC_AXES] = {q->y[k] + q->rub[k], q->y[h + k] + q->rub[h + k]};
        axes_map(c->a->frame, HYSTMPC_AXES, HYSTMPC_AXES, y, 1, q->theta + k, h);
    }
}

/* What the models answer to commands (n, H): travels (2, H), angles y (2, H), the shared friction (2, H), and theta (2, H),
 * without disturbances; `answered`: y are those of the axes' proposals. 0, or another number. */
static int axes_answer(const axes_call *c, const real *plans, int answered, axes_joint *q) {
    const int h = c->horizon;
    real state[AXES_CROSS_STATES];
    axes_follow(c, plans, q);
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        real *const y = q->y + i * h;
        if (answered) copy(c->axis[i].out.angles, y, h);
        else if (hystmpc_model_run(c->axis[i].p->model, q->state[i], 1, h, q->travels + i * h, y, q->room)) return 1;
    }
    if (c->a->cross) {
        copy(c->cross, state, axes_cross_states(c->a));
        hystmpc_cross_run(c->a->cross, h, q->travels, state, q->rub);
    }
    axes_sum(c, q);
    return 0;
}

/* The same, and J (2, H, n, H) of the angles theta by the commands: A (dy / dw + dc / dw) M. */
static int axes_slopes(const axes_call *c, const real *plans, axes_joint *q) {
    const hystmpc_axes *const a = c->a;
    const int h = c->horizon, n = a->commands;
    real *to = q->jacobian, state[AXES_CROSS_STATES];
    axes_follow(c, plans, q);
    fill(q->slopes, R(0.0), HYSTMPC_AXES * HYSTMPC_AXES * h * h);
    for (int i = 0; i < HYSTMPC_AXES; i++)
        if (hystmpc_model_linearise(c->axis[i].p->model, q->state[i], h, q->travels + i * h, q->y + i * h,
                                    q->slopes + 3 * i * h * h, q->room))
            return 1;
    if (a->cross) {
        copy(c->cross, state, axes_cross_states(a));
        hystmpc_cross_slopes(a->cross, h, q->travels, state, q->rub, q->slopes, q->bends);
    }
    axes_sum(c, q);
    for (int o = 0; o < HYSTMPC_AXES; o++)
        for (int k = 0; k < h; k++)
            for (int j = 0; j < n; j++, to += h) {
                real shares[HYSTMPC_AXES * HYSTMPC_AXES];
                for (int i = 0; i < HYSTMPC_AXES * HYSTMPC_AXES; i++)
                    shares[i] = a->frame[o * HYSTMPC_AXES + i / HYSTMPC_AXES] * a->mix[i % HYSTMPC_AXES * n + j];
                fill(to, R(0.0), h);
                add_rows(to, k + 1, shares, 1, q->slopes + k * h, h * h, HYSTMPC_AXES * HYSTMPC_AXES);
            }
    return 0;
}

static long axes_joint_room(const hystmpc_axes *a) {
    const long h = a->first->law->horizon, n = a->commands;
    long numbers = room_for(axes_program(a->law)) + room_for(2L * hystmpc_program_unknowns(a->law));
    numbers += room_for(4 * h * h) + room_for(2 * h * n * h) + room_for(n * h + 1) + 5 * room_for(2 * h) + 2 * room_for(n * h);
    if (a->cross) numbers += room_for(hystmpc_cross_room(a->cross, (int)h));
    for (int i = 0; i < HYSTMPC_AXES; i++) numbers += room_for(hystmpc_model_states(axes_problem(a, i)->model));
    return numbers;
}

long hystmpc_axes_room_bytes(const void *axes) {
    const hystmpc_axes *const a = axes;
    const long h = a->first->law->horizon, samples = hystmpc_reference_samples(a->first);
    long inner = longer(hystmpc_room_bytes(a->first), hystmpc_room_bytes(a->second));
    for (int i = 0; i < HYSTMPC_AXES; i++)
        if (axes_problem(a, i)->model) inner = longer(inner, hystmpc_model_bytes(axes_problem(a, i)->model, 1, (int)h));
    return 2L * ROOM_LINE + 4 * room_for(2 * samples) + room_for(a->commands * h) + room_for(2 * (h + axes_foretold(a))) +
           (a->law ? axes_joint_room(a) : 0L) + inner;
}

/* Moves of the commands (n, H) that the wanted angles in q->y ask for at the axes' static gains, where friction is shared;
 * else none. They cost nothing. What a plan moves beside them is worth less, since a dead band that the other axis removes
 * is not known well. */
static void axes_ask(const axes_call *c, axes_joint *q) {
    const hystmpc_axes *const a = c->a;
    const int h = c->horizon;
    for (int k = 0; k < h; k++) {
        real moves[HYSTMPC_AXES] = {R(0.0), R(0.0)};
        const int to = k + 1 < h ? k + 1 : k;
        for (int i = 0; i < HYSTMPC_AXES && to > 0; i++) {
            const real slope = c->axis[i].p->law->slope, *const y = q->y + i * h;
            if (a->cross && slope > R(0.0)) moves[i] = (y[to] - y[to - 1]) / slope;
        }
        axes_map(a->unmix, a->commands, HYSTMPC_AXES, moves, 1, q->asked + k, h);
    }
}

/* Memory of a joint program, the states from which predictions start, and what is wanted of the models (2, H). */
static void axes_lay_out(const axes_call *c, const real *reference, axes_joint *q, char *room) {
    const hystmpc_axes *const a = c->a;
    const long h = c->horizon, n = a->commands;
    const int delay = a->first->sensing->delay;
    q->program = room_take(&room, axes_program(a->law));
    q->whole = (int *)(void *)room_take(&room, 2L * hystmpc_program_unknowns(a->law));
    q->slopes = room_take(&room, 4 * h * h);
    q->jacobian = room_take(&room, 2 * h * n * h);
    q->better = room_take(&room, n * h + 1);
    q->proposed = room_take(&room, n * h);
    q->asked = room_take(&room, n * h);
    real **const rows[5] = {&q->travels, &q->y, &q->theta, &q->wanted, &q->rub};
    for (int i = 0; i < 5; i++) *rows[i] = room_take(&room, 2 * h);
    q->bends = a->cross ? room_take(&room, hystmpc_cross_room(a->cross, (int)h)) : NULL;
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        const hystmpc_problem *const p = c->axis[i].p;
        q->state[i] = room_take(&room, hystmpc_model_states(p->model));
        hystmpc_observer_state(p->sensing, p->model, &c->axis[i].m.observed, q->state[i]);
        const real off = c->axis[i].m.observed.now.known->disturbance;
        for (int k = 0; k < h; k++) q->y[i * h + k] = reference[i * (h + delay) + delay + k] - off;
    }
    for (int k = 0; k < h; k++) axes_map(a->frame, HYSTMPC_AXES, HYSTMPC_AXES, q->y + k, (int)h, q->wanted + k, (int)h);
    axes_ask(c, q);
    q->room = room;
}

/* One program around plans (n, H) that cost `cost`: they become those of the first share of the way to its solution that
 * cost less. 1 where they did, with what the models answer to them, 0 where not, -1 where a model from outside failed. */
static int axes_improve(const axes_call *c, const hystmpc_task *tasks, real *plans, real cost, axes_joint *q) {
    const hystmpc_axes *const a = c->a;
    const int numbers = a->commands * c->horizon;
    if (axes_slopes(c, plans, q)) return -1;
    if (hystmpc_step_plan(a->law, tasks, q->jacobian, plans, q->theta, a->changes, q->program, q->whole, q->better,
                          q->better + numbers) < 0)
        return 0;
    for (int share = 0; share < AXES_SHARES; share++) {
        if (axes_answer(c, q->better, 0, q)) return -1;
        if (hystmpc_plan_cost(a->law, tasks, q->better, q->theta) < cost) {
            copy(q->better, plans, numbers);
            return 1;
        }
        for (int k = 0; k < numbers; k++) q->better[k] = R(0.5) * (q->better[k] + plans[k]);
    }
    return 0;
}

/* The cheaper one of both axes' plans and of what is left of the last ones, travels `ahead` (2, S), improved by a program
 * for all commands, in place; where that program finds no way, one around the axes' plans. `bound`: limits have moved
 * them. The axes' proposals become its travels and angles, `shared` (2, S) its friction. 0, or another number where a model
 * from outside has failed. */
static int axes_weigh(axes_call *c, int bound, const real *reference, const real *ahead, real *plans, real *shared,
                      char *room) {
    const hystmpc_axes *const a = c->a;
    const int h = c->horizon, n = a->commands, samples = hystmpc_reference_samples(a->first);
    hystmpc_task tasks[HYSTMPC_PULLS];
    axes_joint q;
    axes_lay_out(c, reference, &q, room);
    for (int j = 0; j < n; j++) {
        tasks[j] = (hystmpc_task){
            .reference = q.wanted, .feedforward = plans + j * h, .u_last = c->last[j],
            .rate_weight = a->first->law->rate_weight, .low = -INFINITE, .high = INFINITE, .asked = q.asked + j * h};
        if (j < HYSTMPC_AXES) tasks[j].reference += j * h;
        if (j) tasks[j - 1].next = tasks + j;
    }
    if (axes_answer(c, plans, !bound, &q)) return 1;
    real cost = hystmpc_plan_cost(a->law, tasks, plans, q.theta);
    int rest_is_cheaper = 0;
    if (a->cross) {
        axes_admit(c, ahead, samples, q.better);
        if (axes_answer(c, q.better, 0, &q)) return 1;
        const real other = hystmpc_plan_cost(a->law, tasks, q.better, q.theta);
        rest_is_cheaper = other < cost;
        if (rest_is_cheaper) {
            copy(plans, q.proposed, n * h);
            copy(q.better, plans, n * h);
            cost = other;
        }
    }
    int better = axes_improve(c, tasks, plans, cost, &q);
    if (!better && rest_is_cheaper) { /* a rest within a dead band has no slope that leads out of it: the proposals have */
        better = axes_improve(c, tasks, q.proposed, cost, &q);
        if (better > 0) copy(q.proposed, plans, n * h);
    }
    if (better < 0 || (!better && axes_answer(c, plans, 0, &q))) return 1;
    const int delay = a->first->sensing->delay;
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        const hystmpc_memory *const m = &c->axis[i].m;
        copy(q.travels + i * h, c->axis[i].out.commands, h);
        copy(q.y + i * h, c->axis[i].out.angles, h);
        copy(c->axis[i].out.commands + 1, m->plan, m->head->planned); /* what is left for the next samples */
        copy(c->axis[i].out.angles + 1, m->predicted, m->head->planned);
        if (a->cross) copy(q.rub + i * h, shared + i * samples + delay, h);
    }
    return 0;
}

/* Whether an axis is to move. */
static int axes_move(const axes_call *c) {
    int moves = 0;
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        const axes_one *const one = c->axis + i;
        for (int k = 0; k < c->horizon && !moves; k++)
            moves = absolute(one->out.commands[k] - one->m.observed.now.known->command) > axes_same * one->p->reach;
    }
    return moves;
}

/* Proposals of both axes; 0 where nothing has been started. A stop of one is a stop of both. */
static int axes_propose(axes_call *c, const real *angles_deg, const real *wanted, char *room) {
    real y[HYSTMPC_AXES];
    int begun = 1;
    axes_measured(c, angles_deg, c->a->first->sensing->delay, y);
    if (c->axis[0].m.head->stopped || c->axis[1].m.head->stopped)
        for (int i = 0; i < HYSTMPC_AXES; i++) hystmpc_controller_stop(c->axis[i].p, c->axis[i].memory);
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        axes_one *const one = c->axis + i;
        const int samples = hystmpc_reference_samples(one->p);
        begun &= hystmpc_controller_begin(one->p, &one->m, y[i], wanted + i * samples, &one->out, room);
    }
    return begun;
}

/* Angles theta of what the axes foretell, in the plan's last two rows; not-a-number where an axis foretells nothing. */
static void axes_foretell(const axes_call *c, const real *shared, int samples, real *angles) {
    const int h = c->horizon;
    for (int k = 0; k < h; k++) {
        const real y[HYSTMPC_AXES] = {c->axis[0].out.angles[k] + shared[k], c->axis[1].out.angles[k] + shared[samples + k]};
        axes_map(c->a->frame, HYSTMPC_AXES, HYSTMPC_AXES, y, 1, angles + k, h);
    }
}

int hystmpc_axes_step(const void *axes, char *memory, const real *angles_deg, const real *reference, real *u,
                      void *answers, real *plan, char *room) {
    const hystmpc_axes *const a = axes;
    const int samples = hystmpc_reference_samples(a->first);
    hystmpc_command *const answer = answers;
    axes_call c;
    axes_open(a, memory, &c);
    const int h = c.horizon, n = a->commands;
    room = room_begin(room);
    real *const in_y = room_take(&room, 2L * samples), *const plans = room_take(&room, (long)n * h);
    real *const shared = room_take(&room, 2L * samples), *const ahead = room_take(&room, 2L * samples);
    const int foretold = axes_foretold(a);
    real *const alone = room_take(&room, 2L * samples), *const proposed = room_take(&room, 2L * (h + foretold));
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        c.axis[i].out.commands = proposed + i * h;
        c.axis[i].out.angles = proposed + HYSTMPC_AXES * h + i * foretold;
        fill(c.axis[i].out.angles, (real)NAN, foretold);
    }
    memset(answer, 0, HYSTMPC_AXES * sizeof *answer);
    for (int k = 0; k < samples && reference; k++)
        axes_map(a->unframe, HYSTMPC_AXES, HYSTMPC_AXES, reference + k, samples, in_y + k, samples);
    for (int i = 0; i < HYSTMPC_AXES && !reference; i++) fill(in_y + i * samples, c.axis[i].m.head->target, samples);
    axes_foresee(&c, samples, ahead, shared);
    for (int k = 0; k < 2 * samples; k++) alone[k] = in_y[k] - shared[k];
    if (!axes_propose(&c, angles_deg, alone, room)) {
        for (int j = 0; j < n; j++) u[j] = clamp(is_finite(c.last[j]) ? c.last[j] : a->rest[j], a->lower[j], a->upper[j]);
        for (int i = 0; i < HYSTMPC_AXES; i++)
            answer[i] = (hystmpc_command){.predicted_deg = (real)NAN, .source = HYSTMPC_STOP, .status = HYSTMPC_LATCHED};
        if (plan) fill(plan, (real)NAN, (n + HYSTMPC_AXES) * h);
        return HYSTMPC_AXES;
    }
    const int planned = axes_plan(&c);
    const int bound = planned && axes_admit(&c, proposed, h, plans) > axes_grain;
    const int together = planned && a->cross && axes_move(&c);
    if ((bound || together) && axes_weigh(&c, bound, in_y, ahead, plans, shared, room))
        for (int i = 0; i < HYSTMPC_AXES; i++) c.axis[i].out.status = HYSTMPC_FAILED;
    if (planned) {
        for (int j = 0; j < n; j++) u[j] = plans[j * h];
    } else {
        const real w[HYSTMPC_AXES] = {c.axis[0].out.u, c.axis[1].out.u};
        axes_pull(a, w, c.last, 1, u, 1);
    }
    (void)axes_limit(a, c.last, 1, u, 1);
    copy(u, c.last, n);
    real w[HYSTMPC_AXES];
    int unusual = 0;
    axes_travels(a, u, 1, w, 1);
    axes_rub(&c, w);
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        axes_one *const one = c.axis + i;
        one->out.u = w[i];
        unusual += hystmpc_controller_finish(one->p, &one->m, &one->out, plan != NULL, answer + i, room);
    }
    if (plan && planned) copy(plans, plan, n * h);
    if (plan) axes_foretell(&c, shared, samples, plan + n * h);
    return unusual;
}

int hystmpc_axes_measure(const void *axes, char *memory, const real *angles_deg, real age) {
    axes_call c;
    real y[HYSTMPC_AXES];
    axes_open(axes, memory, &c);
    const int late = is_finite(age) ? (int)clamp(age + R(0.5), R(0.0), (real)HYSTMPC_PAST) : 0;
    axes_measured(&c, angles_deg, c.a->first->sensing->delay + late, y);
    int used = axes_started(&c);
    for (int i = 0; i < HYSTMPC_AXES; i++) used &= is_finite(hystmpc_usable_angle(y[i])); /* of both, or of none */
    for (int i = 0; i < HYSTMPC_AXES && used; i++)
        used = hystmpc_controller_measure(c.axis[i].p, c.axis[i].memory, y[i], age);
    return used;
}

int hystmpc_axes_look_on(const void *axes, char *memory, const real *angles_deg, const real *commands, char *room) {
    const hystmpc_axes *const a = axes;
    axes_call c;
    real y[HYSTMPC_AXES], w[HYSTMPC_AXES];
    int failed = 0;
    axes_open(a, memory, &c);
    if (!axes_started(&c)) return 1;
    axes_measured(&c, angles_deg, a->first->sensing->delay, y);
    for (int j = 0; j < a->commands; j++)
        c.last[j] = clamp(is_finite(commands[j]) ? commands[j] : c.last[j], a->lower[j], a->upper[j]);
    axes_travels(a, c.last, 1, w, 1);
    axes_rub(&c, w);
    for (int i = 0; i < HYSTMPC_AXES; i++) {
        const int samples = hystmpc_controller_look_on(c.axis[i].p, c.axis[i].memory, y[i], w[i], room);
        failed = failed < samples ? samples : failed;
    }
    return failed;
}

void hystmpc_axes_target(const void *axes, char *memory, const real *angles_deg) {
    axes_call c;
    real y[HYSTMPC_AXES];
    axes_open(axes, memory, &c);
    axes_map(c.a->unframe, HYSTMPC_AXES, HYSTMPC_AXES, angles_deg, 1, y, 1);
    for (int i = 0; i < HYSTMPC_AXES; i++) hystmpc_controller_target(c.axis[i].p, c.axis[i].memory, y[i]);
}

void hystmpc_axes_held(const void *axes, char *memory, const real *commands) {
    axes_call c;
    real w[HYSTMPC_AXES];
    axes_open(axes, memory, &c);
    copy(commands, c.last, c.a->commands);
    axes_travels(c.a, c.last, 1, w, 1);
    for (int i = 0; i < HYSTMPC_AXES; i++) hystmpc_controller_held(c.axis[i].p, c.axis[i].memory, w[i]);
}

void hystmpc_axes_hurry(const void *axes, char *memory) {
    axes_call c;
    axes_open(axes, memory, &c);
    for (int i = 0; i < HYSTMPC_AXES; i++) hystmpc_controller_hurry(c.axis[i].p, c.axis[i].memory);
}

void hystmpc_axes_stop(const void *axes, char *memory) {
    axes_call c;
    axes_open(axes, memory, &c);
    for (int i = 0; i < HYSTMPC_AXES; i++) hystmpc_controller_stop(c.axis[i].p, c.axis[i].memory);
}
