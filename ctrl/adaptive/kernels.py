"""Compiled arithmetic of the learned part: plays on the travel, their weights, and derivatives by active branch."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystmpc.models.kernels.numba_ import njit

_EDGE = 1e-12


@njit(cache=True, error_model="numpy", nogil=True)
def add_learned(
    plays: Any, radii: Any, weights: Any, travel: float, start: Any, gain: float, pace: float, plans: Any, angles: Any
) -> None:
    """angles (N, H) += w_0 (v - v_0) + sum_i w_i (p_i - p_i0) + w_v d theta / dt along the plans (N, H), in place.

    start: v_0, the side s of p_i0 = v_0 + s r_i, and the model's angle before the plans; pace: samples per second.
    """
    count = radii.size
    now = np.empty(count)
    for n in range(plans.shape[0]):
        v, before = travel, start[2]
        now[:] = plays
        for k in range(plans.shape[1]):
            v += gain * (plans[n, k] - v)
            total = weights[0] * (v - start[0])
            for i in range(count):
                now[i] = min(max(now[i], v - radii[i]), v + radii[i])
                total += weights[1 + i] * (now[i] - start[0] - start[1] * radii[i])
            theta = angles[n, k]
            angles[n, k] = theta + total + weights[1 + count] * (theta - before) * pace
            before = theta


@njit(cache=True, error_model="numpy", nogil=True)
def add_slopes(
    plays: Any, radii: Any, weights: Any, travel: float, gain: float, pace: float, plan: Any, jacobian: Any
) -> None:
    """The derivative of `add_learned` along one plan (H,), added to that of the model (H, H) in place.

    Both are lower triangular.

    A play at its edge counts as driven: that is the branch on which a motion goes on.
    """
    count, size = radii.size, plan.size
    now, by_v, by_p, slope = plays.copy(), np.zeros(size), np.zeros((count, size)), np.zeros(size)
    v, before, on_rate = travel, np.zeros(size), weights[1 + count] * pace
    for k in range(size):
        v += gain * (plan[k] - v)
        for j in range(k):
            by_v[j] *= 1.0 - gain
        by_v[k] = gain
        for j in range(k + 1):
            slope[j] = weights[0] * by_v[j]
        for i in range(count):
            if v - radii[i] >= now[i] - _EDGE or v + radii[i] <= now[i] + _EDGE:
                now[i] = min(max(now[i], v - radii[i]), v + radii[i])
                for j in range(k + 1):
                    by_p[i, j] = by_v[j]
            for j in range(k + 1):
                slope[j] += weights[1 + i] * by_p[i, j]
        for j in range(k + 1):
            own = jacobian[k, j]
            jacobian[k, j] = own + (slope[j] + on_rate * (own - before[j]))
            before[j] = own
