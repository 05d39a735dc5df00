"""The gates of one LSTM row and their derivative, float32, written so that LLVM vectorises every loop.

All four gates are hyperbolic tangents, sigmoid(z) = 1/2 + 1/2 tanh(z/2), with the inner half already in the weights.
`error_model="numpy"` is what lets the division vectorise: Python's model would test every divisor for zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .numba_ import njit

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
_HALF, _ONE = np.float32(0.5), np.float32(1.0)

# Odd polynomial of degree 13 over even one of degree 6, as in Eigen and XLA: 3e-7 on the whole line.
_LIMIT = np.float32(7.90531110763549805)
_A1, _A3, _A5 = np.float32(4.89352455891786e-03), np.float32(6.37261928875436e-04), np.float32(1.48572235717979e-05)
_A7, _A9 = np.float32(5.12229709037114e-08), np.float32(-8.60467152213735e-11)
_A11, _A13 = np.float32(2.00018790482477e-13), np.float32(-2.76076847742355e-16)
_B0, _B2 = np.float32(4.89352518554385e-03), np.float32(2.26843463243900e-03)
_B4, _B6 = np.float32(1.18534705686654e-04), np.float32(1.19825839466702e-06)


@njit(**_OPTIONS)
def rational_tanh(x: Any) -> Any:
    """tanh(x) to 3e-7 without a branch; not-a-number is clamped away."""
    x = min(max(x, -_LIMIT), _LIMIT)
    s = x * x
    odd = _A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * (_A9 + s * (_A11 + s * _A13)))))
    even = _B0 + s * (_B2 + s * (_B4 + s * _B6))
    return x * odd / even


@njit(**_OPTIONS)
def cell_row(z: Any, bias: Any, c: Any, h: Any) -> None:
    """c' = f c + i g and h' = o tanh(c') of one row (H,) from gate arguments z (4H,), which are used up."""
    n = c.size
    for j in range(4 * n):
        z[j] = rational_tanh(z[j] + bias[j])
    for j in range(n):
        forget, gain = _HALF + _HALF * z[n + j], _HALF + _HALF * z[j]
        c[j] = forget * c[j] + gain * z[2 * n + j]
    for j in range(n):
        h[j] = (_HALF + _HALF * z[3 * n + j]) * rational_tanh(c[j])


@njit(**_OPTIONS)
def differentiated_cell_row(z: Any, bias: Any, c: Any, h: Any, factors: Any) -> None:
    """As `cell_row`, and what `derivative_row` multiplies with, (6, H): by dc, dz_i, dz_f, dz_g; dz_o, dc'."""
    n = c.size
    for j in range(4 * n):
        z[j] = rational_tanh(z[j] + bias[j])
    for j in range(n):
        i, f, g, o = z[j], z[n + j], z[2 * n + j], z[3 * n + j]
        gain, forget, out = _HALF + _HALF * i, _HALF + _HALF * f, _HALF + _HALF * o
        factors[0, j] = forget
        factors[1, j] = _HALF * (_ONE - i * i) * g
        factors[2, j] = _HALF * (_ONE - f * f) * c[j]
        factors[3, j] = gain * (_ONE - g * g)
        c[j] = forget * c[j] + gain * g
        shown = rational_tanh(c[j])
        factors[4, j] = _HALF * (_ONE - o * o) * shown
        factors[5, j] = out * (_ONE - shown * shown)
        h[j] = out * shown


@njit(**_OPTIONS)
def derivative_row(z: Any, factors: Any, c: Any, h: Any) -> None:
    """Derivatives dc', dh' of one row (H,) from those of the gate arguments z (4H,) and dc; in place."""
    n = c.size
    for j in range(n):
        c[j] = factors[0, j] * c[j] + factors[1, j] * z[j] + factors[2, j] * z[n + j] + factors[3, j] * z[2 * n + j]
    for j in range(n):
        h[j] = factors[4, j] * z[3 * n + j] + factors[5, j] * c[j]


@njit(**_OPTIONS)
def add_row(row: Any, other: Any) -> None:
    """row += other."""
    for j in range(row.size):
        row[j] += other[j]


@njit(**_OPTIONS)
def add_multiple(row: Any, factor: Any, other: Any) -> None:
    """row += factor other."""
    for j in range(row.size):
        row[j] += factor * other[j]


@njit(**_OPTIONS)
def dot_row(a: Any, b: Any) -> Any:
    """Sum of a_j b_j."""
    total = np.float32(0.0)
    for j in range(a.size):
        total += a[j] * b[j]
    return total
