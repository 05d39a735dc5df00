/* The rod device: equations of its tendon, segments and friction, and one implicit step of all of them.
 *
 * A tendon passes m contacts with its lumen: p in the shaft, then n at the entrances of the rod's segments. Span j
 * lies behind contact j, j = 0..m, span 0 before the first. With s_j the tendon's displacement in the lumen at contact
 * j [mm] (towards the drive; s_0 is the drive, s_{m+1} = 0 the tip), q_j the bend of the span's segment and T_j its
 * tension:
 *
 *     T_j = max(0, (s_j - s_{j+1} - r (q_j - rest_j)) / c_j)                    elastic, and it can only pull
 *     r T_j + G_j = K_0 (q_j - rest_j - set (R_j - rest_j)) + K_1 (q_j - z_1j) + K_2 (q_j - z_2j)
 *     R_j = the greatest q_j so far,  z_b' = (q - z_b) / tau_b                  set of the first flexure, relaxation
 *     T_{j-1} <= T_j exp(mu phi_j) + h_j,  with equality where the tendon slips towards the drive
 *     T_j <= T_{j-1} exp(mu phi_j) + h_j,  with equality where it slips towards the tip, and no slip otherwise
 *
 * phi_j is the wrap angle at the contact: a constant share of the shaft's bend, or |q_j|. With h = 0 the last two are
 * the capstan equation of Euler and Eytelwein; h is the drag of a contact load that does not come from the tension.
 *
 * One step is a semi-smooth Newton iteration over stick and slip, with shooting as its net. Unknown are the
 * displacements s_1..s_m at the contacts; with ds_j the change in this step and
 *
 *     F+_j = T_{j-1} - exp(mu phi_j) T_j - h_j   (<= 0: whether it may slip towards the drive)
 *     F-_j = T_j - exp(mu phi_j) T_{j-1} - h_j   (<= 0: towards the tip)
 *
 * the set-valued friction law is one equation a contact, for any rho > 0 [mm/N] (here that of the stiffer neighbour,
 * else the choice of stick or slip overshoots):
 *
 *     ds_j = max(0, ds_j + rho F+_j) + min(0, ds_j - rho F-_j)
 *
 * It is piecewise smooth, F+ rises with both neighbours' displacements and falls with its own (F- the other way round),
 * so the Newton matrix is tridiagonal with a dominant diagonal (Facchinei and Pang, 2003, ch. 7). Three to six
 * iterations are usual; where it circles, at the edge of slack or after jumps, `shoot` solves the same law by roots of
 * scalars. */
#include "rod.h"

enum { UP = 1, STICKS = 0, DOWN = -1, LOOSE = -2 };
enum { ROUNDS = 400, NEWTON = 20, GRAVITY_ROUNDS = 100 }; /* doubles are exhausted long before 400 */
enum { SPANS = MOST_CONTACTS + 2 };
static const double EXACT = 1e-13;      /* [mm or N] */
static const double GRAVITY_MM = 1e-10; /* greatest change of a round of the weights */

/* In the order of `RodNumbers` in Python; lengths mm, forces N, angles rad, stiffness N mm/rad. z_b after a step is
 * keep z_b + old q_before + fresh q_after. */
typedef struct {
    double mu, offset, rest;     /* friction, r, natural bend of one segment */
    double stiffness, branch[2]; /* K_0, K_1 and K_2 */
    double set_share, pretension; /* pretension: drive displacement of the untensioned tendon, below 0 of the command */
    double weight, length, down; /* of one segment; down: from the base's axis to the pull of gravity */
    double tolerance_mm;         /* residual of the friction law that a step may leave */
    double keep[2], old[2], fresh[2], drive_share;
} Scalars;

typedef struct {
    const Scalars *n;
    const double *compliance, *wrap, *drag; /* (m + 1,), entry 0 of wrap and drag unused, wrap of the shaft only */
    int shaft, segments, contacts;
} Rod;

/* Of one step, by contact or span 0..m (+1). */
typedef struct {
    double s[SPANS], before[SPANS]; /* (m + 2,) displacements, and those at the step's begin */
    double tension[SPANS], bend[SPANS], load[SPANS]; /* bend 0 in the shaft; load: moment of gravity and memory */
    double slope[SPANS], give[SPANS]; /* dT/dstretch, dq/dstretch */
    double upper[SPANS], right[SPANS]; /* of the tridiagonal system, eliminated */
    double side[SPANS]; /* before and after: 1 where the contact slips towards the drive, -1 to the tip, 2 freely */
    double reached[SPANS]; /* greatest bends before the step */
    double bends[SPANS], late[2][SPANS], moments[SPANS]; /* by segment */
} Work;

/* Direction changes of each contact, by contact 0..m, and memory for one evaluation. */
typedef struct {
    double sticks[SPANS]; /* sigma below which it no longer sticks, of the curve beyond it */
    double width[SPANS];  /* of sigma in which it sticks [N] */
    double loose[SPANS];  /* sigma below which the piece behind it is slack */
    double least[SPANS];  /* tension behind it at `sticks` [N] */
    double given[SPANS];  /* tau behind a contact that sticks or is loose */
    int way[SPANS];       /* of the evaluation */
} Knots;

static Rod rod_of(const double *numbers, int shaft, int segments) {
    const int contacts = shaft + segments;
    const double *compliance = numbers + ROD_NUMBERS, *wrap = compliance + contacts + 1;
    const Scalars *n = (const Scalars *)(const void *)numbers;
    return (Rod){n, compliance, wrap, wrap + contacts + 1, shaft, segments, contacts};
}

/* Stiffness of the branches against a bend within the step. */
static inline double branches(const Scalars *n) {
    return n->branch[0] * (1 - n->fresh[0]) + n->branch[1] * (1 - n->fresh[1]);
}

/* Tension, bend, and their derivatives by the stretch s_j - s_{j+1}, of span j. `load` is the moment that does not come
 * from bend or tendon now: gravity and what the Maxwell branches remember. */
static inline void span(Work *w, int j, const Rod *p) {
    const Scalars *n = p->n;
    const double stretch = w->s[j] - w->s[j + 1], load = w->load[j], reached = w->reached[j], r = n->offset;
    if (j <= p->shaft) {
        const double slope = 1.0 / p->compliance[j];
        const int taut = stretch > 0;
        w->tension[j] = taut ? slope * stretch : 0.0;
        w->slope[j] = taut ? slope : 0.0;
        w->bend[j] = w->give[j] = 0.0;
        return;
    }
    const double late = branches(n);
    double whole = n->stiffness + late; /* free: the bend at no tension */
    double free = (load + n->stiffness * (n->rest + n->set_share * (reached - n->rest))) / whole;
    double slope = 1.0 / (p->compliance[j] + r * r / whole), tension = slope * (stretch - r * (free - n->rest));
    double bend = free + r * most(tension, 0.0) / whole;
    if (bend > reached) { /* the set grows with the bend: a softer law that meets the other at q = reached */
        whole = n->stiffness * (1 - n->set_share) + late;
        free = (load + n->stiffness * (1 - n->set_share) * n->rest) / whole;
        slope = 1.0 / (p->compliance[j] + r * r / whole);
        tension = slope * (stretch - r * (free - n->rest));
        bend = free + r * most(tension, 0.0) / whole;
    }
    const int taut = !(tension <= 0);
    w->tension[j] = taut ? tension : 0.0;
    w->bend[j] = bend;
    w->slope[j] = taut ? slope : 0.0;
    w->give[j] = taut ? r * slope / whole : 0.0;
}

static void spans(Work *w, const Rod *p) {
    for (int j = 0; j <= p->contacts; j++) span(w, j, p);
}

/* Capstan factor exp(mu phi) of contact j; `bend` is that of span j. */
static inline double grip(int j, double bend, const Rod *p) {
    return exp(p->n->mu * (j <= p->shaft ? p->wrap[j] : fabs(bend)));
}

/* Stretch s_j - s_{j+1} and bend of span j at tau, and their slopes: the inverse of `span`. */
typedef struct {
    double stretch, bend, longer, further;
} Stretched;

static inline Stretched stretched(double tau, int j, const Work *w, const Rod *p) {
    const Scalars *n = p->n;
    if (j <= p->shaft) return (Stretched){p->compliance[j] * tau, 0.0, p->compliance[j], 0.0};
    const double late = branches(n), moment = w->load[j] + n->offset * most(tau, 0.0);
    double whole = n->stiffness + late;
    double bend = (moment + n->stiffness * (n->rest + n->set_share * (w->reached[j] - n->rest))) / whole;
    if (bend > w->reached[j]) {
        const double soft = n->stiffness * (1 - n->set_share);
        whole = soft + late;
        bend = (moment + soft * n->rest) / whole;
    }
    const double further = tau > 0 ? n->offset / whole : 0.0;
    return (Stretched){p->compliance[j] * tau + n->offset * (bend - n->rest), bend,
                       p->compliance[j] + n->offset * further, further};
}

typedef struct {
    double tau, tau_slope, slope;
} Curve;

/* How contacts near+1..m move at sigma of the curve (s_near, tau_near); returns what is left of sigma at the tip. */
static double ways(double sigma, int near, Knots *k, const Rod *p) {
    for (int j = near + 1; j <= p->contacts; j++) {
        if (sigma >= k->sticks[j] + k->width[j]) {
            k->way[j] = UP, sigma = sigma - k->width[j];
        } else if (sigma >= k->sticks[j]) {
            k->way[j] = STICKS, k->given[j] = k->least[j] + (sigma - k->sticks[j]), sigma = k->sticks[j];
        } else if (sigma >= k->loose[j]) {
            k->way[j] = DOWN;
        } else {
            k->way[j] = LOOSE, k->given[j] = sigma - k->loose[j], sigma = k->loose[j];
        }
    }
    return sigma;
}

/* Sets s_near..s_m from sigma of the curve (s_near, tau_near); tau_near [N], and the slopes of tau and s by sigma. */
static Curve at(double sigma, int near, Work *w, Knots *k, const Rod *p) {
    const int m = p->contacts;
    double *s = w->s, tau = ways(sigma, near, k, p), tau_slope = 1.0, slope = 0.0;
    s[m + 1] = 0.0;
    for (int j = m; j >= near; j--) {
        const Stretched span = stretched(tau, j, w, p);
        s[j] = s[j + 1] + span.stretch;
        slope = slope + span.longer * tau_slope;
        if (j == near) break;
        const double a = grip(j, span.bend, p);
        const double steep = p->n->mu * span.further * (span.bend > 0 ? 1.0 : -1.0); /* of a, over a */
        if (k->way[j] == UP) {
            tau_slope = tau > 0 ? a * (1.0 + steep * tau) * tau_slope : 0.0;
            tau = a * most(tau, 0.0) + p->drag[j];
        } else if (k->way[j] == DOWN) {
            tau = most(tau - p->drag[j], 0.0) / a;
            tau_slope = tau_slope / a - tau * steep * tau_slope;
        } else {
            tau = k->given[j], tau_slope = 1.0, slope = 0.0;
            if (k->way[j] == STICKS) s[j] = w->before[j];
        }
    }
    return (Curve){tau, tau_slope, slope};
}

/* Sigma at which s_near, or tau_near, is `wanted`; both rise with it. Newton within brackets, else bisection. */
static double root(double wanted, int of_place, double begin, int near, Work *w, Knots *k, const Rod *p) {
    double low = -HUGE_VAL, high = HUGE_VAL, here = begin, reach = 1.0, last = HUGE_VAL;
    for (int round = 0; round < ROUNDS; round++) {
        const Curve curve = at(here, near, w, k, p);
        const double value = (of_place ? w->s[near] : curve.tau) - wanted;
        const double slope = of_place ? curve.slope : curve.tau_slope;
        if (fabs(value) <= EXACT) break;
        if (value < 0)
            low = here;
        else
            high = here;
        const double step = slope > 0 ? -value / slope : HUGE_VAL;
        if (low < here + step && here + step < high && fabs(step) < 0.5 * last) {
            here = here + step, last = fabs(step);
            continue;
        }
        last = HUGE_VAL;
        if (low == -HUGE_VAL || high == HUGE_VAL) {
            const double sign = value > 0 ? 1.0 : value < 0 ? -1.0 : value;
            here = here - sign * reach, reach = 4 * reach;
            continue;
        }
        here = 0.5 * (low + high);
        if (!(low < here && here < high)) break;
    }
    return here;
}

/* Sets the displacements and the sides to their values after the drive has reached `place`. */
static void shoot(double place, Work *w, Knots *k, const Rod *p) {
    const int m = p->contacts;
    double sigma = 0.0;
    for (int j = m; j > 0; j--) {
        sigma = root(w->before[j], 1, sigma, j, w, k, p);
        const double tau = most(at(sigma, j, w, k, p).tau, 0.0), a = grip(j, stretched(tau, j, w, p).bend, p);
        k->least[j] = most(tau - p->drag[j], 0.0) / a;
        k->sticks[j] = sigma, k->width[j] = a * tau + p->drag[j] - k->least[j], k->loose[j] = sigma;
        if (tau > p->drag[j]) k->loose[j] = least(root(p->drag[j], 0, sigma, j, w, k, p), sigma);
    }
    at(root(place, 1, sigma, 0, w, k, p), 0, w, k, p);
    w->s[0] = place;
    for (int j = 1; j <= m; j++) w->side[j] = k->way[j] > LOOSE ? k->way[j] : 0.0;
}

/* Capstan factor exp(mu phi), F+ and F- of contact j. */
typedef struct {
    double a, forward, backward;
} Sides;

static inline Sides sides(int j, const Work *w, const Rod *p) {
    const double a = grip(j, w->bend[j], p), behind = w->tension[j - 1], ahead = w->tension[j];
    return (Sides){a, behind - a * ahead - p->drag[j], ahead - a * behind - p->drag[j]};
}

static inline double rho(int j, const Rod *p) { return 0.5 * least(p->compliance[j - 1], p->compliance[j]); }

/* Row lower x_{j-1} + middle x_j + upper x_{j+1} = right of the Newton matrix; sets the side, returns the residual. */
typedef struct {
    double lower, middle, upper, right, residual;
} Row;

static inline Row row(int j, Work *w, const Rod *p, double guess) {
    const Sides f = sides(j, w, p);
    const double moved = w->s[j] - w->before[j], by_behind = w->slope[j - 1], by_ahead = w->slope[j];
    const double steep = j > p->shaft ? p->n->mu * f.a * w->give[j] * (w->bend[j] > 0 ? 1.0 : -1.0) : 0.0;
    const int slack = by_behind + by_ahead == 0;
    const double goes_on = guess * w->side[j]; /* first guess: contacts that slipped before slip again */
    const int free = f.forward == -f.backward; /* without friction the tensions are equal for either slip direction */
    if ((free || moved + rho(j, p) * f.forward > 0 || goes_on > 0) && !slack) {
        const double ahead = f.a * by_ahead + steep * w->tension[j];
        w->side[j] = free ? 2.0 : 1.0;
        return (Row){-by_behind, by_behind + ahead, -ahead, f.forward, fabs(rho(j, p) * f.forward)};
    }
    if ((moved - rho(j, p) * f.backward < 0 || goes_on < 0) && !slack) {
        const double ahead = by_ahead - steep * w->tension[j - 1];
        w->side[j] = -1.0;
        return (Row){-f.a * by_behind, f.a * by_behind + ahead, -ahead, -f.backward, fabs(rho(j, p) * f.backward)};
    }
    w->side[j] = 0.0;
    return (Row){0.0, 1.0, 0.0, -moved, fabs(moved)};
}

/* One Newton step of s, none if the residual is within tolerance; returns the residual before it [mm]. */
static double newton(Work *w, const Rod *p, double guess, double hold, double room) {
    double worst = 0.0, last_upper = 0.0, last_right = 0.0;
    for (int j = 1; j <= p->contacts; j++) { /* rows are eliminated on the way */
        Row r = row(j, w, p, guess);
        worst = most(worst, r.residual);
        /* A taut piece between slack ones floats: the matrix would be singular. */
        if (w->slope[j - 1] * w->slope[j] == 0) r.middle += hold / p->compliance[j];
        r.middle -= r.lower * last_upper;
        last_right = (r.right - r.lower * last_right) / r.middle;
        last_upper = r.upper / r.middle;
        w->upper[j] = last_upper, w->right[j] = last_right;
    }
    if (worst <= p->n->tolerance_mm) return worst;
    const double pull = w->s[0] - w->before[0], low = least(pull, 0.0) - room, high = most(pull, 0.0) + room;
    double step = 0.0;
    for (int j = p->contacts; j > 0; j--) {
        step = w->right[j] - w->upper[j] * step;
        /* A slip does not end beyond where it began, and does not outrun the drive by much at first. */
        double moved = least(most(w->s[j] + step - w->before[j], low), high);
        if (w->side[j] < 2) moved = w->side[j] > 0 ? most(moved, 0.0) : w->side[j] < 0 ? least(moved, 0.0) : 0.0;
        w->s[j] = w->before[j] + moved;
    }
    return worst;
}

/* Greatest residual of the friction law at s and the tensions in `w` [mm]. */
static double residual_of(const Work *w, const Rod *p) {
    double worst = 0.0;
    for (int j = 1; j <= p->contacts; j++) {
        const Sides f = sides(j, w, p);
        const double moved = w->s[j] - w->before[j], up = most(0.0, moved + rho(j, p) * f.forward);
        worst = most(worst, fabs(moved - up - least(0.0, moved - rho(j, p) * f.backward)));
    }
    return worst;
}

static int finite_sum(const double *s, int count) {
    double sum = 0.0;
    for (int j = 0; j < count; j++) sum += s[j];
    return sum - sum == 0.0;
}

/* Displacements s (m + 2,) after the drive has reached `place`; returns the remaining residual [mm]. `w` holds initial
 * state and loads, and afterwards tensions and bends; its `side` is the last slip. */
static double solve(double place, Work *w, const Rod *p) {
    const int count = p->contacts + 2;
    double guess = 1.0, hold = 1.0, room = 0.1 * fabs(place - w->before[0]) + 1e-3;
    for (int j = 0; j < count; j++) w->s[j] = w->before[j];
    w->s[0] = place;
    for (int round = 0; round < NEWTON; round++) {
        spans(w, p);
        const double residual = newton(w, p, guess, hold, room);
        if (residual <= p->n->tolerance_mm && finite_sum(w->s, count)) return residual;
        guess = 0.0, hold = 0.4 * hold, room = least(2 * room, 1e3);
    }
    Knots knots;
    shoot(place, w, &knots, p);
    spans(w, p);
    return residual_of(w, p);
}

/* Moments of the weights: first where the middle of each segment lies across the pull of gravity, then their sums. */
void hystmpc_rod_gravity(const double *bends, double *moments, int segments, double weight, double length,
                         double down) {
    double heading = 0.0, across = 0.0, total = 0.0, weights = 0.0;
    for (int i = 0; i < segments; i++) {
        heading += bends[i];
        across += 0.5 * length * sin(heading - down);
        moments[i] = across;
        across += 0.5 * length * sin(heading - down);
    }
    double joint = across;
    for (int i = segments - 1; i >= 0; i--) {
        const double middle = moments[i];
        joint = 2 * middle - joint; /* the segment's own entrance */
        total += middle;
        weights += 1.0;
        moments[i] = -weight * (total - weights * joint);
    }
}

/* Sets the bending moments besides the tendon's: of gravity, and what the branches remember. */
static void loads(Work *w, const Rod *p) {
    const Scalars *n = p->n;
    for (int i = 0; i < p->segments; i++) {
        double load = w->moments[i];
        for (int b = 0; b < 2; b++) load += n->branch[b] * (n->keep[b] * w->late[b][i] + n->old[b] * w->bends[i]);
        w->load[p->shaft + 1 + i] = load;
    }
}

/* Round after round of the weights' moments at the bends that they cause: a contraction, since `RodParameters` bounds
 * weight over stiffness. Returns the last residual. */
static double settle(double place, double residual, Work *w, const Rod *p) {
    double *bend = w->bend + p->shaft + 1, before[SPANS];
    for (int round = 0; round < GRAVITY_ROUNDS; round++) {
        double change = 0.0;
        for (int i = 0; i < p->segments; i++) before[i] = bend[i];
        hystmpc_rod_gravity(before, w->moments, p->segments, p->n->weight, p->n->length, p->n->down);
        loads(w, p);
        residual = solve(place, w, p);
        for (int i = 0; i < p->segments; i++) change = most(change, p->n->offset * fabs(bend[i] - before[i]));
        if (change <= GRAVITY_MM) break;
    }
    return residual;
}

/* Moves displacements, bends and branches on with the drive going to `place`; returns the residual. */
static double step(double place, Work *w, const Rod *p) {
    const Scalars *n = p->n;
    const int first = p->shaft + 1;
    for (int j = 0; j < p->contacts + 2; j++) w->before[j] = w->s[j];
    loads(w, p);
    double residual = solve(place, w, p);
    if (n->weight > 0) residual = settle(place, residual, w, p);
    for (int i = 0; i < p->segments; i++) {
        const double bend = w->bend[first + i];
        for (int b = 0; b < 2; b++)
            w->late[b][i] = n->keep[b] * w->late[b][i] + n->old[b] * w->bends[i] + n->fresh[b] * bend;
        w->bends[i] = bend;
        w->reached[first + i] = most(w->reached[first + i], bend);
    }
    return residual;
}

/* Between the state and the arrays of a step; `out` writes the state. */
static void exchange(double *state, Work *w, const Rod *p, int out) {
    const int m = p->contacts, n = p->segments, first = p->shaft + 1;
    double *kept = state + 1 + 2 * m;
    double *ours[6] = {w->s + 1, w->side + 1, w->bends, w->late[0], w->late[1], w->reached + first};
    double *theirs[6] = {state + 1, state + 1 + m, kept, kept + n, kept + 2 * n, kept + 3 * n};
    for (int a = 0; a < 6; a++) {
        double *to = out ? theirs[a] : ours[a];
        const double *from = out ? ours[a] : theirs[a];
        for (int i = 0; i < (a < 2 ? m : n); i++) to[i] = from[i];
    }
}

double hystmpc_rod(double *state, const double *commands, int samples, int parts, int shaft, int segments,
                   const double *numbers, double *angle, double *drive, double *tension) {
    if (shaft < 0 || segments < 0 || shaft > MOST_CONTACTS - segments) return HUGE_VAL;
    const Rod p = rod_of(numbers, shaft, segments);
    const Scalars *n = p.n;
    Work w = {.s = {0.0}};
    double x = state[0], worst = 0.0;
    exchange(state, &w, &p, 0);
    w.s[0] = x + n->pretension;
    if (n->weight > 0) hystmpc_rod_gravity(w.bends, w.moments, segments, n->weight, n->length, n->down);
    for (int k = 0; k < samples; k++) {
        for (int part = 0; part < parts; part++) {
            x += n->drive_share * (commands[k] - x);
            worst = most(worst, step(x + n->pretension, &w, &p));
        }
        double bend = 0.0;
        for (int i = 0; i < segments; i++) bend += w.bends[i];
        angle[k] = bend * (180.0 / 3.14159265358979323846), drive[k] = x, tension[k] = w.tension[0];
    }
    state[0] = x;
    exchange(state, &w, &p, 1);
    return worst;
}
