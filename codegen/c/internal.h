/* What the files of the controller share: short names, the problem's numbers, functions by file. */
#ifndef HYSTMPC_INTERNAL_H
#define HYSTMPC_INTERNAL_H

#include "hystmpc.h"
#include "hystmpc_numbers.h"

#ifndef HYSTMPC_LOCAL
#define HYSTMPC_LOCAL /* both `static` where all files are one */
#define HYSTMPC_SHARED
#endif

#include "real.h"

#if HYSTMPC_SENSES
#include "estimator.h"
#endif
#if HYSTMPC_LEARNS
#include "learning.h"
#endif

/* At the beginning of a line of the cache, so that no vector lies across two. */
#ifdef __GNUC__
#define HYSTMPC_AT_A_LINE __attribute__((aligned(64)))
#else
#define HYSTMPC_AT_A_LINE
#endif

#define INFINITE ((real)INFINITY)

enum { H = HYSTMPC_HORIZON, S = HYSTMPC_STATES };

HYSTMPC_LOCAL real root(real x);
HYSTMPC_LOCAL int all_finite(const real *x, int count);
HYSTMPC_LOCAL void copy(const real *from, real *to, int count);
HYSTMPC_LOCAL void fill(real *to, real value, int count);
HYSTMPC_LOCAL int factorise(real *p, int width, int count);
HYSTMPC_LOCAL void solve_upper(const real *g, int width, int count, real *x);
HYSTMPC_LOCAL void solve_lower(const real *g, int width, int count, real *x);

/* model.c: one step of a model, its tangent, and loops around them. */
typedef struct {
    int size;
    void (*step)(const real *x, real u, real *theta, real *next);
    /* Also d next / d x (column by column), d next / d u, d theta / d x, d theta / d u. */
    void (*tangent)(const real *x, real u, real *theta, real *next, real *a, real *b, real *c, real *d);
} model;

#ifndef HYSTMPC_ONE_FILE
#if !HYSTMPC_UNITS
extern const model hystmpc_whole; /* command to angle */
#endif
#if HYSTMPC_FRONT
extern const model hystmpc_front; /* dynamics of the command */
#endif
#if HYSTMPC_BACK
extern const model hystmpc_back; /* dynamics of the angle */
#endif
#if HYSTMPC_UNITS
extern const float hystmpc_weights[], hystmpc_head[];
#endif
/* tables.c */
#if HYSTMPC_SENSES
extern const hystmpc_noise hystmpc_noises;
#endif
#if HYSTMPC_LEARNS
extern const hystmpc_learner hystmpc_learns;
#endif
#endif
/* The operators that are inverted sample by sample: their step, and the angle with its derivative by the command. */
HYSTMPC_LOCAL void step_middle(const real *x, real u, real *theta, real *next);
HYSTMPC_LOCAL void slope_middle(const real *x, real u, real *theta, real *d);
HYSTMPC_LOCAL void hystmpc_rest(real y, real u, real *x); /* the model's state at rest, by the rule of its file */

#if HYSTMPC_FRONT || !HYSTMPC_UNITS
HYSTMPC_LOCAL void run_plan(const model *m, const real *x, const real *plan, int samples, real *angles);
HYSTMPC_LOCAL void linearise_plan(hystmpc_work *w, const model *m, const real *x, const real *plan, real *angles);
#endif
HYSTMPC_LOCAL real command_for(const real *x, real wanted, real last);

/* The whole, and what is inverted sample by sample: operators (model.c), or a network and operators (network.c). */
HYSTMPC_LOCAL void model_step(const real *x, real u, real *theta, real *next);
HYSTMPC_LOCAL void run_model(const real *x, const real *plan, int samples, real *angles);
HYSTMPC_LOCAL void run_plans(hystmpc_work *w, const real *x, real (*plans)[HYSTMPC_HORIZON], int count,
                             real (*angles)[HYSTMPC_HORIZON]);
HYSTMPC_LOCAL void linearise_model(hystmpc_work *w, const real *x, const real *plan);
HYSTMPC_LOCAL void middle_step(real *x, real u);
HYSTMPC_LOCAL real middle_command(const real *x, real wanted, real last);
#if HYSTMPC_UNITS
HYSTMPC_LOCAL real network_step(real *state, real u);
#endif

#if HYSTMPC_FRONT || HYSTMPC_BACK
HYSTMPC_LOCAL void fit_drive(hystmpc_work *w, const model *m, const real *x, const real *wanted, real u_last,
                             real reach, real *inputs);
HYSTMPC_LOCAL int first_acting(const hystmpc_work *w);
#endif

/* state.c: the model with what is learned on top of it. */
HYSTMPC_LOCAL void state_run(const hystmpc_state *s, const real *plan, real *angles);
HYSTMPC_LOCAL void state_run_plans(hystmpc_work *w, const hystmpc_state *s, real (*plans)[HYSTMPC_HORIZON], int count,
                                   real (*angles)[HYSTMPC_HORIZON]);
HYSTMPC_LOCAL void state_linearise(hystmpc_work *w, const hystmpc_state *s, const real *plan);
HYSTMPC_LOCAL real state_inverse(const hystmpc_state *s, real theta, real u_last);
HYSTMPC_LOCAL void state_follow(hystmpc_work *w, const hystmpc_state *s, const real *wanted, real u_last, real *boxed,
                                real *limited);
#if HYSTMPC_SUPERVISED
HYSTMPC_LOCAL void state_advance(hystmpc_state *s, real u);
#endif

/* qp.c */
HYSTMPC_LOCAL int solve_program(hystmpc_work *w, real *primal);

/* planner.c */
typedef struct {
    const hystmpc_state *state;
    const real *reference;   /* wanted angles of the model, H */
    const real *feedforward; /* from which effort is measured, H */
    real u_last;
    real low, high; /* soft limits of the angle */
} problem;

typedef struct {
    real commands[HYSTMPC_HORIZON];
    real angles[HYSTMPC_HORIZON];
    real cost;
} plan;

HYSTMPC_LOCAL void clip_plan(real *commands, real last);
HYSTMPC_LOCAL real plan_cost(const problem *p, const real *commands, const real *angles);
HYSTMPC_LOCAL int improve(hystmpc_work *w, const problem *p, plan *best);
HYSTMPC_LOCAL void build_program(hystmpc_work *w, const problem *p, const plan *around);
HYSTMPC_LOCAL void deviation(const real *primal, real *commands);

/* law.c: what a law is given, and what it proposes. */
typedef struct {
    hystmpc_state state;
    real reference[HYSTMPC_HORIZON];
    real disturbance, sigma, measured, age, u_last, due, setpoint, forecast_error;
} given;

typedef struct {
    real u;
    int source, status, planned;
    real commands[HYSTMPC_HORIZON];
    real angles[HYSTMPC_HORIZON];
} proposal;

HYSTMPC_LOCAL void init_predictive(hystmpc_controller *c);
HYSTMPC_LOCAL void propose_predictive(hystmpc_controller *c, const given *g, proposal *out);
HYSTMPC_LOCAL real within_limits(real u, real last);
#if HYSTMPC_SUPERVISED
HYSTMPC_LOCAL void init_supervisor(hystmpc_controller *c);
HYSTMPC_LOCAL void propose_supervised(hystmpc_controller *c, const given *g, proposal *out);
#endif

/* observer.c */
enum { HYSTMPC_MARK = 0x48595354 }; /* which nothing else leaves in memory by chance */
HYSTMPC_LOCAL int later(int samples);
HYSTMPC_LOCAL real usable_angle(real y);
HYSTMPC_LOCAL int estimate_init(hystmpc_estimate *e, real y, real u);
HYSTMPC_LOCAL int estimate_correct(hystmpc_estimate *e, real y);
HYSTMPC_LOCAL int estimate_advance(hystmpc_estimate *e, real u);

#endif
