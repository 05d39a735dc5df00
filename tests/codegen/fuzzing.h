/* Random calls on an exported controller, and whether what one axis remembers stays finite. After hystmpc.c. */
#include <stdio.h>

#ifndef STEPS
#define STEPS 3000
#endif

#define COUNT(x) (int)(sizeof(x) / sizeof(real))
static unsigned long long state = 1u;

static unsigned below(unsigned count) {
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return (unsigned)(state >> 33) % count;
}

static real between(real low, real high) { return low + (high - low) * (real)below(100001) / (real)100000; }

/* Mostly a number as it should be, between `low` and `high`. */
static real any(real low, real high) {
    static const double odd[] = {0.0, -0.0, 1e-310, -1e-310, 1e-45, 1e30, -1e30, 1e308, -1e308, 9999.0, -9999.0, 1e4};
    const unsigned kind = below(40);
    if (kind == 0) return (real)NAN;
    if (kind == 1) return (real)INFINITY;
    if (kind == 2) return -(real)INFINITY;
    if (kind < 8) return (real)odd[below(sizeof odd / sizeof odd[0])];
    return between(low, high);
}

static int finite_all(const void *at, int count) {
    const real *x = at;
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i])) return 0;
    return 1;
}

static int estimate_finite(const hystmpc_sensing *s, const hystmpc_estimate *e, int states) {
    const hystmpc_noise *n = s->noise;
    const hystmpc_known *k = e->known;
    const int entries = states ? s->delay + 1 : 0;
    return isfinite(k->command) && isfinite(k->disturbance) && isfinite(k->variance) && isfinite(k->measured) &&
           finite_all(e->model, states) && finite_all(e->angles, entries) && finite_all(e->moves, entries) &&
           (!n || finite_all(e->bank, 3 * n->sensors * n->drifts * n->motions));
}

static int learning_finite(const hystmpc_learning *l, const hystmpc_learner *n) {
    const hystmpc_filters *f = l->filters;
    return finite_all(l->past, hystmpc_numbers_past(n)) && finite_all(l->added, n->delay + 1) &&
           finite_all(f->z, COUNT(f->z)) && finite_all(f->covariance, COUNT(f->covariance)) &&
           finite_all(f->frozen, COUNT(f->frozen)) && finite_all(f->sums, COUNT(f->sums)) &&
           finite_all(f->scores, COUNT(f->scores)) && isfinite(f->forecast_error) && isfinite(f->share);
}

/* Whether all that one axis remembers is finite. */
static int memory_finite(const hystmpc_problem *p, char *memory) {
    const hystmpc_model *model = p->model;
    const int states = model ? model->predictor->states : 0;
    hystmpc_memory m;
    hystmpc_memory_at(p, memory, &m);
    const hystmpc_head *h = m.head;
    int finite = isfinite(h->due) && finite_all(m.plan, h->planned) && finite_all(m.predicted, h->planned) &&
                 finite_all(m.fed, h->fed) && finite_all(m.due, h->dues) && isfinite(h->integral) &&
                 isfinite(h->speed) && isfinite(h->angle) && isfinite(h->age);
    if (!model || !model->learner) return finite && estimate_finite(p->sensing, &m.observed.now, states);
    return finite && estimate_finite(p->sensing, &m.observed.now, 0) && estimate_finite(p->sensing, &m.observed.alone, states) &&
           learning_finite(&m.observed.learning, model->learner);
}
