/* Drawn devices: one sample, roll-outs, and a loop under PID for its tuning. */
#include "drawn.h"

#include "friction.h"
#include "muscle.h"
#include "rod.h"

enum { CAPSTAN, DAHL, ROD, MUSCLE };
enum { OWN = 4 };          /* entries of the state beside the commands and the core's */
enum { MUSCLE_PARTS = 2 }; /* steps of a muscle in a fine step, whose valve takes 2 ms */
static const double FINE_S = 0.002;

/* In the order of `packed` in Python. */
typedef struct {
    double lag_share;         /* share of the travel to the command in a fine step, 1 without a lag */
    double frequency, damping; /* of a second-order servo [rad/s], 0 for none */
    double creep, creep_share; /* final over instant response, minus 1; share of the creep in a fine step */
    double gain, offset_deg;  /* gain [deg/mm], 1 for the muscle */
} Drawn;
enum { DRAWN_NUMBERS = 7 };

typedef struct {
    const Drawn *n;
    const double *core;
    int kind, fine, commands, delay, steps, size, segments; /* in the order of `sizes` */
    int states;                                             /* S */
    double *places, *spare; /* inputs of the core (max(fine, SETTLE) + 1,), five times as many behind them */
} Device;

/* The device with its working memory, and the states behind it. */
static Device device_of(const int *sizes, const double *numbers, double **work) {
    Device d = {(const Drawn *)(const void *)numbers, numbers + DRAWN_NUMBERS, sizes[0], sizes[1], sizes[2], sizes[3],
                sizes[4],  sizes[5], sizes[6], 0, *work, 0};
    const int places = (d.fine > SETTLE ? d.fine : SETTLE) + 1;
    const int core = d.kind == ROD ? 1 + 2 * (d.size + d.segments) + 4 * d.segments : d.size;
    d.states = d.commands + OWN + core;
    d.spare = d.places + places;
    *work += 6 * places;
    return d;
}

static void copy(double *to, const double *from, int count) {
    for (int i = 0; i < count; i++) to[i] = from[i];
}

/* Inputs of the core, places (fine + 1,), over one sample under the command u; the first is the last one before it.
 *
 * Delay; lag x' = (u - x) / tau, exact, or servo x'' = w^2 (u - x) - 2 zeta w x', semi-implicit; then one Kelvin-Voigt
 * element, z' = (x - z) / tau, place = x + creep z. */
static void drive(const Device *d, double *state, double u) {
    const Drawn *p = d->n;
    const int q = d->commands, fine = d->fine;
    double *own = state + q, x = own[0], v = own[1], z = own[2];
    for (int k = 0; k < q - 1; k++) state[k] = state[k + 1];
    state[q - 1] = u;
    d->places[0] = own[3];
    for (int j = 0; j < fine; j++) {
        const int late = d->delay > j ? (d->delay - j + fine - 1) / fine : 0;
        const double sent = state[q - 1 - late];
        if (p->frequency > 0.0) {
            const double w = p->frequency * FINE_S;
            v = (v + p->frequency * w * (sent - x)) / (1.0 + 2.0 * p->damping * w + w * w);
            x += FINE_S * v;
        } else {
            x += p->lag_share * (sent - x);
        }
        z += p->creep_share * (x - z);
        d->places[j + 1] = x + p->creep * z;
    }
    own[0] = x, own[1] = v, own[2] = z, own[3] = d->places[fine];
}

/* Angle [deg] after the inputs places (n + 1,), starting at the core's present one, to which a rod goes in `steps`;
 * moves the state of the core on. */
static double bend(const Device *d, double *core, int n, int steps) {
    const Drawn *p = d->n;
    const double *c = d->core, *places = d->places;
    double *out = d->spare;
    if (d->kind == CAPSTAN) {
        const double *shares = c + 3, *weights = shares + d->size, one = 1.0;
        hystmpc_capstan(places + 1, n, c[0], &one, 0, c[2], core, d->size, shares, weights, weights + d->size, c[1], out);
        return p->offset_deg + p->gain * out[n - 1];
    }
    if (d->kind == DAHL) {
        const double *widths = c + 2, *shares = widths + d->size;
        double *scale = out + n + 1;
        scale[0] = 1.0; /* of no step */
        for (int k = 1; k <= n; k++) {
            const double speed = (places[k] - places[k - 1]) / (FINE_S * c[1]);
            scale[k] = 1.0 + c[0] * exp(-speed * speed);
        }
        hystmpc_dahl(places, n + 1, scale, 1, widths, shares, core, d->size, out);
        return p->offset_deg + p->gain * (places[n] - out[n]);
    }
    if (d->kind == MUSCLE) {
        hystmpc_muscle(core, places + 1, n, c, FINE_S, MUSCLE_PARTS, out, out + n);
        return p->offset_deg + p->gain * out[n - 1];
    }
    double *coarse = out + steps, *unused = coarse + steps; /* at most `n` steps */
    for (int k = 0; k < steps; k++) coarse[k] = places[n * (k + 1) / steps];
    hystmpc_rod(core, coarse, steps, 1, d->size, d->segments, c, out, unused, unused + steps);
    return p->offset_deg + p->gain * (out[steps - 1] * (3.14159265358979323846 / 180.0)) * c[1]; /* the rod's offset */
}

/* True angle at the end of one sample under the command u [deg]. */
static double advance(const Device *d, double *state, double u) {
    drive(d, state, u);
    return bend(d, state + d->commands + OWN, d->fine, d->steps);
}

double hystmpc_drawn_step(const int *sizes, const double *numbers, double *state, double u, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    return advance(&d, state, u);
}

void hystmpc_drawn(const int *sizes, const double *numbers, double *state, const double *commands, int samples,
                   double *theta, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    for (int k = 0; k < samples; k++) theta[k] = advance(&d, state, commands[k]);
}

void hystmpc_drawn_rollout(const int *sizes, const double *numbers, const double *state, const double *plans, int rows,
                           int horizon, double *theta, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    for (int n = 0; n < rows; n++) {
        copy(work, state, d.states);
        for (int t = 0; t < horizon; t++) theta[n * horizon + t] = advance(&d, work, plans[n * horizon + t]);
    }
}

void hystmpc_drawn_linearise(const int *sizes, const double *numbers, const double *state, const double *plan,
                             int horizon, double small, int blocks, double *theta, double *jacobian, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    const int size = d.states, count = blocks < horizon ? blocks : horizon;
    double *states = work + size; /* `work`: the state that moves; those before each sample (H, S) */
    copy(work, state, size);
    for (int k = 0; k < horizon; k++) {
        copy(states + k * size, work, size);
        theta[k] = advance(&d, work, plan[k]);
    }
    for (int i = 0; i < horizon * horizon; i++) jacobian[i] = 0.0;
    for (int b = 0; b < count; b++) {
        const int start = horizon * b / count, stop = horizon * (b + 1) / count;
        copy(work, states + start * size, size);
        for (int k = start; k < horizon; k++) {
            const double change = (advance(&d, work, k < stop ? plan[k] + small : plan[k]) - theta[k]) / small;
            const int sharing = (k + 1 < stop ? k + 1 : stop) - start;
            for (int i = 0; i < sharing; i++) jacobian[k * horizon + start + i] = change / sharing;
        }
    }
}

/* Angle after a straight move to x, less theta. */
static double miss(const Device *d, const double *state, double x, double theta, double *core) {
    const int before = d->commands + OWN;
    copy(core, state + before, d->states - before);
    d->places[0] = state[d->commands + 3];
    for (int i = 1; i <= SETTLE; i++) d->places[i] = x;
    return bend(d, core, SETTLE, 1) - theta;
}

double hystmpc_drawn_place(const int *sizes, const double *numbers, const double *state, double theta, double low,
                           double high, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    double at_low = miss(&d, state, low, theta, work), at_high = miss(&d, state, high, theta, work);
    double x = state[d.commands + 3];
    if (at_low >= 0.0) return low;
    if (at_high <= 0.0) return high;
    for (int round = 0; round < 12; round++) {
        const double error = miss(&d, state, x, theta, work);
        if (fabs(error) < 1e-3) break;
        /* Illinois: the end that stays counts half, so that it does not stay for ever. */
        if (error > 0.0)
            high = x, at_high = error, at_low = 0.5 * at_low;
        else
            low = x, at_low = error, at_high = 0.5 * at_high;
        x = (low * at_high - high * at_low) / (at_high - at_low);
    }
    return x;
}

/* In the order of `PidNumbers` in Python. */
typedef struct {
    double kp, ki, kd, filter_s, tracking_s, dead_zone_deg, lower, upper, reach, dt;
} Pid;

double hystmpc_drawn_pid(const int *sizes, const double *numbers, const double *rest, double angle,
                         const double *wanted, const double *due, const double *feedforward, const double *noise,
                         int samples, int first, const double *gains, double *work) {
    const Device d = device_of(sizes, numbers, &work);
    const Pid *g = (const Pid *)(const void *)gains;
    const double smooth = g->dt / (g->filter_s + g->dt), span = g->upper - g->lower;
    double u = g->lower, integral = 0.0, speed = 0.0, y = angle + noise[0], before = y, total = 0.0;
    copy(work, rest, d.states);
    for (int k = 0; k < samples; k++) {
        const double error = due[k] == due[k] ? due[k] - y : 0.0;
        speed += smooth * ((y - before) / g->dt - speed);
        before = y;
        const double asked = feedforward[k] + g->kp * error + integral - g->kd * speed;
        u = least(most(asked, most(g->lower, u - g->reach)), least(g->upper, u + g->reach));
        const double held = fabs(error) > g->dead_zone_deg ? error : 0.0;
        integral += g->dt * (g->ki * held + (u - asked) / g->tracking_s);
        integral = least(most(integral, -span), span);
        angle = advance(&d, work, u);
        y = angle + noise[k + 1];
        if (k >= first) total += (angle - wanted[k]) * (angle - wanted[k]);
    }
    return total / (samples - first);
}
