/* Search for the angle given to a core at which a whole chain shows a certain angle.
 *
 * What a chain shows rises with the core's angle within the core's range, and is flat beyond it. Newton's step is taken
 * where it stays between the points known to be too low and too high, else the middle of them. Beyond the range, with
 * no point on the other side, the search goes on a little within its edge; where nothing there is nearer, the first
 * point beyond it stays. */
#ifndef HYSTMPC_REST_SEARCH_H
#define HYSTMPC_REST_SEARCH_H

#include "real.h"

/* Most evaluations of the chain, tolerance [deg], and slope that leads nowhere. */
enum { REST_MOST = 60 };
#define REST_CLOSE R(1e-9)
#define REST_FLAT R(1e-3)
#define REST_FAR R(1e30)

typedef struct {
    real at;        /* angle given to the core [deg] */
    real low, high; /* greatest angle known to be too low, and least known to be too high */
    real given;     /* first point beyond the range */
    real edge;      /* the last edge that the search came from: 1 the lower one, -1 the upper one, 0 none */
    int within;     /* the present point lies a little within the edge */
    int open;       /* the search goes on */
} rest_search;

static inline rest_search rest_search_from(real at) {
    const rest_search s = {at, -REST_FAR, REST_FAR, at, R(0.0), 0, 1};
    return s;
}

/* The next point, from what is missing at the present one, the slope there, what the core shows, and the step back from
 * an edge. Answers whether the point has moved, also in the last step of the search. */
static inline int rest_search_move(rest_search *s, real miss, real slope, real core, real back) {
    const real side = miss > R(0.0) ? R(1.0) : R(-1.0), last = s->at;
    const int flat = absolute(slope) < REST_FLAT, came_within = s->within;
    s->within = 0;
    if (absolute(miss) < REST_CLOSE) return s->open = 0;
    if (miss > R(0.0)) s->low = s->at > s->low ? s->at : s->low;
    else s->high = s->at < s->high ? s->at : s->high;
    const int between = s->low > -REST_FAR && s->high < REST_FAR && s->low < s->high;
    const real middle = R(0.5) * (s->low + s->high);
    if (!flat) {
        const real next = s->at + miss / slope;
        s->at = between && !(next > s->low && next < s->high) ? middle : next;
    } else if (between) {
        s->at = middle;
    } else if (came_within || s->edge * side > R(0.5)) {
        s->at = s->given, s->open = 0;
    } else {
        if (absolute(s->edge) < R(0.5)) s->given = s->at;
        s->at = core + side * back, s->edge = side, s->within = 1;
    }
    if (!(s->at < last || s->at > last)) s->open = 0;
    return s->at < last || s->at > last;
}

#endif
