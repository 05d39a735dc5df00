/* The simulated tendon catheter of sim/devices/tendon.py, whose docstring has the equations and their source (S2). */
#ifndef HYSTMPC_TENDON_H
#define HYSTMPC_TENDON_H

#include "hystmpc_core.h"
#include "real.h"

/* Moves the state (N + 5,) on by commands (T,) [mm], each held for dt [s].
 *
 * State: N friction elements [deg], drive [mm], roughness, viscoelastic and creep angle [deg], greatest drive [mm].
 * `widths` (N,) of the elements, `bumps` (T,) standard normal; `numbers` (20,) are the fields of `Tendon` in tendon.c,
 * in their order. Outputs (T,): angle [deg], drive [mm], tension [N]. */
HYSTMPC_API void hystmpc_tendon(real *state, const real *widths, int count, const real *commands,
                                const real *bumps, int samples, const real *numbers, real dt, real *angle,
                                real *drive, real *tension);

#endif
