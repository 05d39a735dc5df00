/* The simulated tendon catheter: friction elements between its loading and its unloading line. */
#include "tendon.h"

/* In the order of `TendonNumbers` in Python. */
typedef struct {
    real drive_share; /* 1 - exp(-dt / drive_lag) */
    real middle_slope, middle_deg, half_gap_slope, half_gap_deg, end_deg, end_mm, viscous_s_per_mm;
    real roughness, roughness_mm, viscoelastic, viscoelastic_share, creep, creep_share;
    real set_deg, set_mm, offset_deg, pretension_n, stiffness_n_per_mm, friction_tension;
} tendon_numbers;

/* Mean of the elements (N,) after the walls `half` around `middle` have moved them: friction holds an element until a
 * wall reaches it, z_i = max(M - w_i h, min(M + w_i h, z_i)). */
static real tendon_elements(real *z, const real *widths, int count, real middle, real half) {
    real total = R(0.0);
    for (int i = 0; i < count; i++) {
        z[i] = most(middle - widths[i] * half, least(middle + widths[i] * half, z[i]));
        total += z[i];
    }
    return total / (real)count;
}

void hystmpc_tendon(real *state, const real *widths, int count, const real *commands, const real *bumps,
                    int samples, const real *numbers, real dt, real *angle, real *drive, real *tension) {
    const tendon_numbers *p = (const tendon_numbers *)(const void *)numbers;
    real *own = state + count, x = own[0], rough = own[1], viscous = own[2], creep = own[3], reached = own[4];
    for (int k = 0; k < samples; k++) {
        const real step = p->drive_share * (commands[k] - x);
        x += step;
        const real travel = MATH(fabs)(step), keep = MATH(exp)(-travel / p->roughness_mm);
        rough = keep * rough + p->roughness * MATH(sqrt)(most(1 - keep * keep, R(0.0))) * bumps[k];
        const real middle = p->middle_deg + p->middle_slope * x + p->end_deg * MATH(exp)(-x / p->end_mm);
        const real half = (p->half_gap_deg + p->half_gap_slope * x) * (1 + p->viscous_s_per_mm * travel / dt) *
                            most(1 + rough, R(0.0));
        const real bend = tendon_elements(state, widths, count, middle, half);
        viscous += p->viscoelastic_share * (bend - viscous);
        creep += p->creep_share * (bend - creep);
        reached = most(reached, x);
        const real set_left = p->set_deg * most(1 - reached / p->set_mm, R(0.0));
        angle[k] = bend + p->viscoelastic * (viscous - bend) + p->creep * (creep - bend) + p->offset_deg - set_left;
        drive[k] = x;
        const real stick = half > 0 ? (middle - bend) / half : R(0.0); /* 1 on the loading, -1 on the unloading line */
        tension[k] = (p->pretension_n + p->stiffness_n_per_mm * x) * (1 + p->friction_tension * (stick - 1));
    }
    own[0] = x, own[1] = rough, own[2] = viscous, own[3] = creep, own[4] = reached;
}
