/* A drawn device of devices/drawn.py as a whole: drive, creep and core; its roll-outs, and a loop under PID.
 *
 * `sizes` (7,): kind of the core (0 capstan or joints, 1 Dahl, 2 rod, 3 muscle), fine steps in a sample, commands Q that
 * are kept, delay in fine steps, steps of a rod in a sample; entries of the core's state, of a rod its contacts in
 * the shaft; of a rod its segments. `numbers`: the fields of `Drawn` in drawn.c in their order, then those of the core:
 * of a capstan wrap, pretension, curl, shares, weights and drags, (N,) each; of Dahl elements the share b by which friction is
 * greater at rest, its speed v_s, widths (N,), which are multiplied by 1 + b exp(-(v / v_s)^2), and shares (N,); of rod
 * and muscle those of rod.h and muscle.h.
 *
 * State (S,): commands (Q,), drive, its speed, creep, last place of the core, state of the core. `work` is
 * 6 (max(fine, SETTLE) + 1) numbers, plus as many states as each function says. */
#ifndef HYSTMPC_LAB_DRAWN_H
#define HYSTMPC_LAB_DRAWN_H

#include "lab.h"

enum { SETTLE = 5 }; /* fine steps in which the muscle's valve settles */

/* Moves the state on by one command; returns the true angle [deg] at the end of the sample. */
HYSTMPC_API double hystmpc_drawn_step(const int *sizes, const double *numbers, double *state, double u, double *work);

/* Moves the state on by commands (T,); true angles theta (T,) [deg] at the ends of the samples. */
HYSTMPC_API void hystmpc_drawn(const int *sizes, const double *numbers, double *state, const double *commands,
                               int samples, double *theta, double *work);

/* Angles theta (N, H) of plans (N, H) from one state; work and one state. */
HYSTMPC_API void hystmpc_drawn_rollout(const int *sizes, const double *numbers, const double *state,
                                       const double *plans, int rows, int horizon, double *theta, double *work);

/* Angles theta (H,) along a plan (H,), and their differences over `small` by its commands (H, H), `blocks` columns at
 * once; work and H + 1 states. */
HYSTMPC_API void hystmpc_drawn_linearise(const int *sizes, const double *numbers, const double *state,
                                         const double *plan, int horizon, double small, int blocks, double *theta,
                                         double *jacobian, double *work);

/* Input of the core within [low, high] at which a straight move from the present one gives `theta`; work and one
 * state. */
HYSTMPC_API double hystmpc_drawn_place(const int *sizes, const double *numbers, const double *state, double theta,
                                       double low, double high, double *work);

/* Mean square true error [deg^2] from sample `first` on under a PID controller, hystmpc's ctrl/feedback.py, from rest
 * at the command `lower`; work and one state.
 *
 * `wanted` (N,): reference at the ends of the samples [deg]; `due` (N,): what the measurement at each sample's begin is
 * compared with, not-a-number for the first one; `feedforward` (N,): added to the feedback; `noise` (N + 1,) of the
 * measurements. `gains` (10,) are the fields of `Pid` in drawn.c, in their order; `angle` is the true one at rest. */
HYSTMPC_API double hystmpc_drawn_pid(const int *sizes, const double *numbers, const double *rest, double angle,
                                     const double *wanted, const double *due, const double *feedforward,
                                     const double *noise, int samples, int first, const double *gains, double *work);

#endif
