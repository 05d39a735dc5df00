/* Predictors: a tree of chains, networks, sums and series of two, and functions of Python; see predictor.h. */
#include "linear.h"
#include "predictor.h"
#include "room.h"

enum { TREE_ABREAST = 16 }; /* rows of a chain that run side by side at most */

/* Bytes of a chain for up to so many rows: as many as fill whole fours take the most. */
static long tree_chain_bytes(const hystmpc_predictor *p, int rows, int samples) {
    const int fours = rows < 2 ? 1 : (rows + 3) / 4 * 4, abreast = fours < TREE_ABREAST ? fours : TREE_ABREAST;
    const long run = longer(hystmpc_chain_bytes(p->chain, abreast, 0), hystmpc_chain_bytes(p->chain, 1, 0));
    return longer(run, longer(hystmpc_chain_single_bytes(p->chain), hystmpc_chain_linearise_bytes(p->chain, samples)));
}

static long tree_network_bytes(const hystmpc_predictor *p, int rows, int samples) {
    const int together = hystmpc_network_together(), most_rows = rows < together ? rows : together;
    const int derived = 1 + samples;
    return (long)sizeof(real) * hystmpc_network_room(p->network, most_rows < derived ? derived : most_rows);
}

long hystmpc_predictor_bytes(const void *predictor, int rows, int samples) {
    const hystmpc_predictor *const p = predictor;
    const int count = rows < 1 ? 1 : rows;
    const long plans = room_for((long)count * samples), square = room_for((long)samples * samples);
    if (p->kind == HYSTMPC_CHAIN) return ROOM_LINE + tree_chain_bytes(p, count, samples);
    if (p->kind == HYSTMPC_RECURRENT) return ROOM_LINE + tree_network_bytes(p, count, samples);
    if (p->kind == HYSTMPC_WRITTEN) return ROOM_LINE;
    const long below = longer(hystmpc_predictor_bytes(p->first, count, samples),
                              hystmpc_predictor_bytes(p->second, count, samples));
    return ROOM_LINE + below + plans + square + 2 * room_for(samples) + room_for(p->first->states);
}

/* Whether all numbers are finite, by their sum: one that overflows counts as not finite. */
static int tree_finite_sum(const real *x, int states, const real *plans, long count) {
    real sum = R(0.0);
    for (int i = 0; i < states; i++) sum += x[i];
    for (long i = 0; i < count; i++) sum += plans[i];
    return is_finite(sum);
}

/* One sample of two predictors; where the second one fails, the first one's state is put back. */
static int tree_advance_pair(const hystmpc_predictor *p, real *x, real u, real *theta, char *room) {
    const int beside = p->kind == HYSTMPC_ACCOMPANIED, size = p->first->states;
    real *const second = x + size + beside, *const before = room_take(&room, size);
    real main_angle = R(0.0), other = R(0.0);
    copy(x, before, size);
    int failed = hystmpc_predictor_advance(p->first, x, u, &main_angle, room);
    if (failed) return failed;
    failed = hystmpc_predictor_advance(p->second, second, p->kind == HYSTMPC_SERIES ? main_angle : u, &other, room);
    if (failed) {
        copy(before, x, size);
        return failed;
    }
    if (beside) second[-1] = main_angle, x[p->states - 1] = other;
    *theta = beside ? main_angle : p->kind == HYSTMPC_SERIES ? other : main_angle + other;
    return 0;
}

int hystmpc_predictor_advance(const void *predictor, real *x, real u, real *theta, char *room) {
    const hystmpc_predictor *const p = predictor;
    room = room_begin(room);
    switch (p->kind) {
    case HYSTMPC_CHAIN: *theta = hystmpc_chain_step(p->chain, p->kept, x, u, room); return 0;
    case HYSTMPC_RECURRENT:
        if (tree_finite_sum(x, p->states, &u, 1)) {
            hystmpc_network_sample(p->network, x, 1, &u, theta, (real *)(void *)room);
        } else {
            *theta = (real)NAN;
            fill(x, (real)NAN, p->states);
        }
        return 0;
    case HYSTMPC_WRITTEN: return p->outside->advance(x, u, theta);
    default: return tree_advance_pair(p, x, u, theta, room);
    }
}

/* Angles of a network. Plans that are not finite have none; a plan's angles do not depend on those beside it. */
static void tree_run_network(const hystmpc_predictor *p, const real *x, int rows, int samples, const real *plans,
                             real *angles, real *room) {
    if (tree_finite_sum(x, p->states, plans, (long)rows * samples)) {
        hystmpc_network_rollout(p->network, x, plans, rows, samples, angles, room);
        return;
    }
    const int usable = all_finite(x, p->states);
    for (int n = 0; n < rows; n++, plans += samples, angles += samples) {
        if (usable && all_finite(plans, samples))
            hystmpc_network_rollout(p->network, x, plans, 1, samples, angles, room);
        else fill(angles, (real)NAN, samples);
    }
}

/* Angles of two predictors in series or in parallel. */
static int tree_run_pair(const hystmpc_predictor *p, const real *x, int rows, int samples, const real *plans,
                         real *angles, char *room) {
    const int series = p->kind == HYSTMPC_SERIES;
    const long count = (long)rows * samples;
    real *const first = room_take(&room, count);
    int failed = hystmpc_predictor_run(p->first, x, rows, samples, plans, first, room);
    if (failed) return failed;
    const real *const given = series ? first : plans;
    failed = hystmpc_predictor_run(p->second, x + p->first->states, rows, samples, given, angles, room);
    if (failed || series) return failed;
    for (long i = 0; i < count; i++) angles[i] = first[i] + angles[i];
    return 0;
}

int hystmpc_predictor_run(const void *predictor, const real *x, int rows, int samples, const real *plans, real *angles,
                          char *room) {
    const hystmpc_predictor *const p = predictor;
    room = room_begin(room);
    switch (p->kind) {
    case HYSTMPC_CHAIN: hystmpc_chain_roll_out(p->chain, p->kept, x, rows, samples, plans, NULL, angles, room); return 0;
    case HYSTMPC_RECURRENT:
        tree_run_network(p, x, rows, samples, plans, angles, (real *)(void *)room);
        return 0;
    case HYSTMPC_ACCOMPANIED: return hystmpc_predictor_run(p->first, x, rows, samples, plans, angles, room);
    case HYSTMPC_WRITTEN: return p->outside->run(x, rows, samples, plans, angles);
    default: return tree_run_pair(p, x, rows, samples, plans, angles, room);
    }
}

/* Slopes of a series, d theta / d u = (d theta / d v) (d v / d u): by (H, H) <- by `inner`, both lower triangular. */
static void tree_chain_rule(real *by, const real *inner, int samples, real *row) {
    for (int i = 0; i < samples; i++, by += samples) {
        fill(row, R(0.0), i + 1);
        add_rows(row, i + 1, by, 1, inner, samples, i + 1); /* zeros above the diagonal of `inner` */
        copy(row, by, i + 1);
    }
}

/* Angles and slopes of two predictors in series or in parallel. */
static int tree_linearise_pair(const hystmpc_predictor *p, const real *x, int samples, const real *plan, real *angles,
                               real *jacobian, char *room) {
    const int series = p->kind == HYSTMPC_SERIES;
    const long count = (long)samples * samples;
    real *const first = room_take(&room, samples), *const row = room_take(&room, samples);
    real *const by_first = room_take(&room, count);
    int failed = hystmpc_predictor_linearise(p->first, x, samples, plan, first, by_first, room);
    if (failed) return failed;
    failed = hystmpc_predictor_linearise(p->second, x + p->first->states, samples, series ? first : plan, angles,
                                         jacobian, room);
    if (failed) return failed;
    if (series) {
        tree_chain_rule(jacobian, by_first, samples, row);
        return 0;
    }
    for (int k = 0; k < samples; k++) angles[k] = first[k] + angles[k];
    for (long i = 0; i < count; i++) jacobian[i] = by_first[i] + jacobian[i];
    return 0;
}

/* The lower half of a matrix with one value, zeros above. */
static void tree_fill_lower(real *matrix, real value, int size) {
    for (int i = 0; i < size; i++, matrix += size) {
        fill(matrix, value, i + 1);
        fill(matrix + i + 1, R(0.0), size - i - 1);
    }
}

int hystmpc_predictor_linearise(const void *predictor, const real *x, int samples, const real *plan, real *angles,
                                real *jacobian, char *room) {
    const hystmpc_predictor *const p = predictor;
    room = room_begin(room);
    switch (p->kind) {
    case HYSTMPC_CHAIN: hystmpc_chain_linearise(p->chain, p->kept, x, plan, NULL, samples, angles, jacobian, room); return 0;
    case HYSTMPC_RECURRENT: {
        const int usable = tree_finite_sum(x, p->states, plan, samples);
        tree_fill_lower(jacobian, usable ? R(0.0) : (real)NAN, samples);
        if (!usable) fill(angles, (real)NAN, samples);
        else hystmpc_network_linearise(p->network, x, plan, samples, angles, jacobian, (real *)(void *)room);
        return 0;
    }
    case HYSTMPC_ACCOMPANIED: return hystmpc_predictor_linearise(p->first, x, samples, plan, angles, jacobian, room);
    case HYSTMPC_WRITTEN: return p->outside->linearise(x, samples, plan, angles, jacobian);
    default: return tree_linearise_pair(p, x, samples, plan, angles, jacobian, room);
    }
}
