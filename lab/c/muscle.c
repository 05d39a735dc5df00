/* Valve, bladder, braid friction and a segment that stiffens. */
#include "muscle.h"

/* In the order of `MuscleNumbers` in Python. */
typedef struct {
    double supply_bar, valve_s, fill_s, vent_s, slack_bar, slack_width_bar, friction, presliding_bar;
    double greatest_deg, half_bar, late, late_share, bend_share;
} Muscle;

/* Pressure that reaches the braid: a smooth max(p - at, 0) that is 0 at p = 0. */
static double beyond_slack(double pressure, double at, double width) {
    return width * (log1p(exp((pressure - at) / width)) - log1p(exp(-at / width)));
}

/* One sample; friction and presliding are the caller's. */
static void sample(double *state, double command, const Muscle *p, double rubbing, double presliding, double h,
                   int parts) {
    double pressure = state[0], before = state[1], friction = state[2], late = state[3], bend = state[4];
    for (int part = 0; part < parts; part++) {
        double flow = (command - pressure) / p->valve_s;
        flow = least(most(flow, -pressure / p->vent_s), (p->supply_bar - pressure) / p->fill_s);
        pressure = most(pressure + h * flow, 0.0);
        const double bladder = beyond_slack(pressure, p->slack_bar, p->slack_width_bar), step = bladder - before;
        before = bladder;
        const double side = step > 0 ? 1.0 : -1.0;
        friction = side + (friction - side) * exp(-fabs(step) / presliding);
        const double pull = most(bladder * (1 - rubbing * friction), 0.0);
        const double still = p->greatest_deg * pull / (pull + p->half_bar);
        late += p->late_share * (still - late);
        bend += p->bend_share * (still + p->late * (late - still) - bend);
    }
    state[0] = pressure, state[1] = before, state[2] = friction, state[3] = late, state[4] = bend;
}

void hystmpc_muscle(double *state, const double *commands, int samples, const double *numbers, double dt, int parts,
                    double *angle, double *pressure) {
    const Muscle *p = (const Muscle *)(const void *)numbers;
    for (int k = 0; k < samples; k++) {
        sample(state, commands[k], p, p->friction, p->presliding_bar, dt / parts, parts);
        angle[k] = state[4];
        pressure[k] = state[0];
    }
}

void hystmpc_rubbing_muscle(double *state, const double *x, int samples, const double *friction, const double *numbers,
                            double dt, int parts, double *out) {
    const Muscle *p = (const Muscle *)(const void *)numbers;
    for (int k = 0; k < samples; k++) {
        const double bladder = beyond_slack(x[k], p->slack_bar, p->slack_width_bar);
        const double presliding = most(p->presliding_bar, 2 * friction[k] * bladder / (1 - friction[k]));
        sample(state, x[k], p, friction[k], presliding, dt / parts, parts);
        out[k] = state[4];
    }
}
