"""Compiled float32 kernels of a stacked LSTM: step, batched roll-out and Jacobian by forward sensitivity.

The plain route: matrix products through BLAS (`np.dot`), everything between them in loops that LLVM vectorises. All four
gates are evaluated as one hyperbolic tangent, sigmoid(z) = 1/2 + 1/2 tanh(z/2); the halves are already in the packed
weights. A clamp inside turns not-a-number into a number: check inputs before.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import njit

Float32 = np.ndarray[tuple[int, ...], np.dtype[np.float32]]

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
# Rational tanh of Eigen and XLA: odd polynomial of degree 13 over even polynomial of degree 6, 2e-7 on the whole line.
_LIMIT = np.float32(7.90531110763549805)
_A1, _A3, _A5, _A7 = (np.float32(a) for a in (4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05, 5.12229709037114e-08))
_A9, _A11, _A13 = (np.float32(a) for a in (-8.60467152213735e-11, 2.00018790482477e-13, -2.76076847742355e-16))
_B0, _B2, _B4, _B6 = (np.float32(b) for b in (4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06))


@njit(cache=True, fastmath=True, inline="always")
def _tanh(x):
    x = min(max(x, -_LIMIT), _LIMIT)
    s = x * x
    p = _A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * (_A9 + s * (_A11 + s * _A13)))))
    q = _B0 + s * (_B2 + s * (_B4 + s * _B6))
    return x * p / q


@njit(cache=True, fastmath=True)
def _tanh_row(row):
    for j in range(row.size):
        row[j] = _tanh(row[j])


@njit(cache=True, fastmath=True)
def _advance_row(z, c, h):
    """c' = f c + i g, h' = o tanh(c') of one row from its gates' arguments z (4H,); z is overwritten."""
    n = c.size
    _tanh_row(z)
    i, f, g, o = z[:n], z[n : 2 * n], z[2 * n : 3 * n], z[3 * n :]
    for j in range(n):
        c[j] = (_HALF + _HALF * f[j]) * c[j] + (_HALF + _HALF * i[j]) * g[j]
    for j in range(n):
        h[j] = (_HALF + _HALF * o[j]) * _tanh(c[j])


