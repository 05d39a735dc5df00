/* Recurrent networks in single precision: a stacked LSTM, a stacked GRU, and the increment-gated LSTM.
 *
 * With the scaled command v = (u - u_offset) / u_scale and theta = theta_offset + theta_scale y (Wu et al., RA-L 2021,
 * eq. (1), for the LSTM; Cho et al., EMNLP 2014, for the GRU; `GatedLstmNet` in Python for the gated one). */
#ifndef HYSTMPC_NETWORK_H
#define HYSTMPC_NETWORK_H

#include "hystmpc_core.h"
#include "real.h"

enum { HYSTMPC_LSTM = 0, HYSTMPC_GRU = 1, HYSTMPC_GATED = 2 };

/* A network, at an address that 64 divides. Behind it stand its float numbers:
 *
 *     panels of the first layer, U / lanes, each (1 + I + U, 4, lanes): bias, then the weights of one input after the
 *         other, four sums a unit; those under a sigmoid halved, sigmoid(z) = 1/2 + 1/2 tanh(z/2)
 *     panels of each further layer, each (1 + 2 U, 4, lanes)
 *     head (U,) of the last layer's outputs, head (I,) of the inputs, radii (I - 1,) of the plays
 *
 * U: units of a layer, `hidden` filled up to a multiple of lanes and of 8 by units that stay zero. I: inputs of the first
 * layer. The four sums are those of the gates i, f, g, o of an LSTM; of r, z, and both parts of n of a GRU. */
typedef struct hystmpc_network {
    real u_offset, u_scale, theta_offset, theta_scale;
    real head_bias;
    int kind, layers, hidden;
    int inputs;                /* I: 1, the command; and the plays of a gated LSTM */
    float keep, settled, rate; /* k, e, -1 / s of a gated LSTM; 0 for no lag, and no gate */
    float spare[HYSTMPC_SINGLE ? 20 : 15]; /* up to 128 bytes */
} hystmpc_network;

/* Units of a panel: numbers in a vector of this library. */
HYSTMPC_API int hystmpc_network_lanes(void);

/* Numbers of a state: (h, c) of each layer of an LSTM, h of a GRU, (w, plays, h, c) of a gated LSTM. */
HYSTMPC_API int hystmpc_network_state(const hystmpc_network *network);

/* Numbers of work space for so many rows at once: plans of a roll-out, at most `hystmpc_network_together`; 1 + K for K
 * commands of a linearisation. Best where 64 divides its address. */
HYSTMPC_API long hystmpc_network_room(const hystmpc_network *network, int rows);
HYSTMPC_API int hystmpc_network_together(void);

/* One motion, in place: motion = [state (S), commands (K), room for one row] becomes [state behind, angles (K) [deg], .]. */
HYSTMPC_API void hystmpc_network_advance(const hystmpc_network *network, real *motion, int samples);

/* One sample of a few states (rows, S) under commands u (rows,), in place; theta (rows,) takes the angles [deg]. */
HYSTMPC_API void hystmpc_network_sample(const hystmpc_network *network, real *states, int rows, const real *u,
                                        real *theta, real *work);

/* Angles (N, K) [deg] of the plans (N, K) from one state (S,). A plan's angles do not depend on the plans beside it. */
HYSTMPC_API void hystmpc_network_rollout(const hystmpc_network *network, const real *state, const real *plans,
                                         int count, int samples, real *angles, real *work);

/* Angles (K,) [deg] along a plan (K,) and their derivative (K, K) by its commands, whose upper part is left alone. */
HYSTMPC_API void hystmpc_network_linearise(const hystmpc_network *network, const real *state, const real *plan,
                                           int samples, real *angles, real *jacobian, real *work);

#endif
