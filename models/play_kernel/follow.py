"""Compiled pass of a command through a lag and plays."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystmpc.trials.types import Vec

from ..kernels.numba_ import njit


def follow_plays(command: Vec, gain: float, radii: Vec, state: Vec) -> Vec:
    """States (T, 1 + n) after each sample: v += gain (u - v), then p_i = max(v - r_i, min(v + r_i, p_i)).

    Args:
        command: u (T,).
        gain: 1 without a lag.
        radii: r (n,).
        state: v and p before the first sample (1 + n,); left as it is.
    """
    states = np.empty((command.size, state.size))
    _follow(np.ascontiguousarray(command), gain, radii, state.copy(), states)
    return states


@njit(cache=True, error_model="numpy", nogil=True)
def _follow(command: Any, gain: float, radii: Any, now: Any, states: Any) -> None:
    for k in range(command.size):
        u = command[k]
        v = u if gain == 1.0 else now[0] + gain * (u - now[0])
        now[0] = v
        states[k, 0] = v
        for i in range(radii.size):
            p = max(v - radii[i], min(v + radii[i], now[i + 1]))
            now[i + 1] = p
            states[k, i + 1] = p
