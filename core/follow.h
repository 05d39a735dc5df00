/* Inverses along a preview: of a chain, of a network beside which a chain runs, and the input that leads a drive. */
#ifndef HYSTMPC_FOLLOW_H
#define HYSTMPC_FOLLOW_H

#include "chain.h"
#include "network.h"

/* Commands along the angles `wanted` (H), each by the inverse of the chain, within [low, high] of the bounds (low, high,
 * reach).
 *
 * x: the chain's state (S), or with a network [network, its angle, chain, its angle]: the chain is asked for the wanted
 * angle and what it is off the network by then. plans (2, H): row 0 within the box alone, row 1 also moves by no more
 * than `reach` in a sample. The inverse searches between inverted[0] and inverted[1]. memory: hystmpc_follow_bytes. */
HYSTMPC_API void hystmpc_follow(const int *chain, const real *kept, const hystmpc_network *network, const real *x,
                                const real *wanted, int samples, real last, const real *bounds, const real *inverted,
                                real *plans, char *memory);
HYSTMPC_API long hystmpc_follow_bytes(const int *chain, const hystmpc_network *network);

/* Inputs (H) whose outputs (H) come closest to `wanted`.
 *
 *     min_m  sum_k (v_k(u) - w_k)^2 + eps sum_k m_k^2   s.t.  |m_k| <= reach,   u_k = u_{k-1} + m_k */
HYSTMPC_API void hystmpc_lead_drive(const int *chain, const real *kept, const real *x, const real *wanted, int samples,
                                    real last, real reach, real *inputs, real *outputs, char *memory);
HYSTMPC_API long hystmpc_lead_drive_bytes(const int *chain, int samples);

#endif
