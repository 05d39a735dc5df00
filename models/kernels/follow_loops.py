"""The inverse followed along a horizon. This file's text is compiled behind a header that imports, never imported.

The header gives `step` and `command_for` of the chain that is inverted (`chain_loops`), and `sample`, which moves the
first `rows` of a table of network states by one sample:

    sample(packed, states (2, S), rows, v (2,), theta (2,))
"""
# ruff: noqa: F821  (the header's names)
# mypy: ignore-errors
# pyright: reportUndefinedVariable=false

import math

import numpy as np

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy", nogil=True)
def within(u, low, high, last):
    """Nearest command in [low, high]; `last` where `u` is no number."""
    return min(max(u if math.isfinite(u) else last, low), high)


@njit(cache=True, error_model="numpy", nogil=True)
def follow(packed, size, state, p, dt, k_step, k_slope, wanted, u_last, bounds, inverted, plans):
    """Commands (2, H) along the angles `wanted` (H,): row 0 within [low, high] alone, row 1 within the rate limit too.

    state: [network (S,), its angle, chain, its angle], or the chain alone where `size` = S = 0. The chain is asked for
    the wanted angle and what it is off the network by then. bounds: low, high, greatest change per sample; inverted:
    least and greatest command among which the inverse searches. There is one row until it wants more than the rate
    limit allows.
    """
    low, high, reach = bounds[0], bounds[1], bounds[2]
    first, final = (size + 1, state.size - 1) if size > 0 else (0, state.size)
    own, beside, following = np.empty((2, size)), np.empty((2, final - first)), np.empty(final - first)
    own[0], beside[0] = state[:size], state[first:final]
    theta, angle = np.zeros(2), np.zeros((2, 1))
    if size > 0:
        theta[0], angle[0, 0] = state[size], state[final]
    last, u = np.empty(2), np.empty(2)
    last[0] = u_last
    rows = 1
    for n in range(wanted.size):
        for row in range(rows):
            off = angle[row, 0] - theta[row] if size > 0 else 0.0
            goal = command_for(beside[row], wanted[n] + off, inverted[0], inverted[1], last[row], p, dt, k_slope)
            u[row] = within(goal, low, high, last[row])
        if rows == 1 and abs(u[0] - last[0]) > reach:
            rows = 2
            own[1], beside[1] = own[0], beside[0]
            theta[1], angle[1], last[1], u[1] = theta[0], angle[0], last[0], u[0]
        if rows == 2:
            u[1] = min(max(u[1], last[1] - reach), last[1] + reach)
        for row in range(rows):
            last[row] = u[row]
            step(beside[row], u[row : row + 1], p, dt, angle[row], following, k_step)
            beside[row] = following
        if size > 0:
            sample(packed, own, rows, u, theta)
        plans[0, n], plans[1, n] = u[0], u[rows - 1]
