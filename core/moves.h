/* Moves that lead a drive along a path: bounded least squares. */
#ifndef HYSTMPC_MOVES_H
#define HYSTMPC_MOVES_H

#include "hystmpc_core.h"
#include "linear.h"

/* First sample that an input changes: rows of the response (H, H) before it are zero; H where none does. */
HYSTMPC_API int hystmpc_first_acting(const real *response, int size);

/* argmin over |m_k| <= reach of |G (m - m_0) - e|^2 + w |m|^2, in place from `moves` m_0 (H); by_move: G (H, H), lower
 * triangular; off: e (H); work: 2 H (H + 2) numbers. */
HYSTMPC_API void hystmpc_bounded_moves(const real *by_move, const real *off, int size, real reach, real weight,
                                       real *moves, real *work);

#endif
