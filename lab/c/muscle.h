/* The catheter bent by a pneumatic artificial muscle; its equations stand in devices/muscle.py, `MuscleCatheter`. */
#ifndef HYSTMPC_LAB_MUSCLE_H
#define HYSTMPC_LAB_MUSCLE_H

#include "lab.h"

/* Moves the state (5,) on through commands (T,) [bar], each in `parts` steps of dt / parts [s]; outputs (T,): angle
 * [deg] and pressure [bar]. The state is pressure [bar], pressure at the braid [bar], friction in -1..1, late angle
 * and angle [deg]. `numbers` (13,) are the fields of `Muscle` in muscle.c, in their order. */
HYSTMPC_API void hystmpc_muscle(double *state, const double *commands, int samples, const double *numbers, double dt,
                                int parts, double *angle, double *pressure);

/* Angle out (T,) [deg] under pressures x (T,) [bar] in `parts` steps each; friction f (T,) over pull stands for that
 * among the numbers. The pull b (1 - f z) turns with z within the presliding: that is at least 2 f b / (1 - f), so that
 * the pull never rises as the pressure b falls. */
HYSTMPC_API void hystmpc_rubbing_muscle(double *state, const double *x, int samples, const double *friction,
                                        const double *numbers, double dt, int parts, double *out);

#endif
