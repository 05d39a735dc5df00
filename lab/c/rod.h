/* The rod device: a tendon with friction in its lumen bends a rod of segments. Equations and method: rod.c. */
#ifndef HYSTMPC_LAB_ROD_H
#define HYSTMPC_LAB_ROD_H

#include "lab.h"

enum { MOST_CONTACTS = 100, ROD_NUMBERS = 19 };

/* Moves the state on through commands (T,) [mm], each in `parts` steps; outputs (T,): angle [deg], drive [mm], tension
 * at the drive [N]. Returns the greatest residual of the friction law [mm]; infinity, with nothing done, where the
 * contacts m = shaft + segments are more than MOST_CONTACTS.
 *
 * State (1 + 2 m + 4 n,): drive, displacements at the contacts [mm], last slip direction of each (1, -1, or 0), bends
 * of the n segments, two branches, greatest bends [rad]. `numbers`: the ROD_NUMBERS fields of `Scalars` in rod.c in
 * their order, then compliance c_j [mm/N], wrap angle [rad] and drag h_j [N] (m + 1,) each. */
HYSTMPC_API double hystmpc_rod(double *state, const double *commands, int samples, int parts, int shaft, int segments,
                               const double *numbers, double *angle, double *drive, double *tension);

/* Moments (n,) [N mm] of the segments' weights at their joints, each weight [N] in the middle of its segment, for the
 * bends (n,) [rad]; `down` is the angle from the base's axis to the pull of gravity [rad]. */
HYSTMPC_API void hystmpc_rod_gravity(const double *bends, double *moments, int segments, double weight, double length,
                                     double down);

#endif
