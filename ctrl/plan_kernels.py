"""Compiled loops over the plans of the predictive controllers: limits, candidates, costs."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy", nogil=True)
def clip_plans(plans: Any, lower: float, upper: float, reach: float, last: float) -> None:
    """Nearest admissible plans (N, H) sample by sample, in place; not-a-number stays what it is."""
    last = min(max(last, lower), upper)
    for n in range(plans.shape[0]):
        before = last
        for k in range(plans.shape[1]):
            u = plans[n, k]
            if u == u:
                u = min(max(min(max(u, lower), upper), before - reach), before + reach)
            plans[n, k] = u
            before = u


@njit(cache=True, error_model="numpy", nogil=True)
def run_ahead(plan: Any, reach: float) -> None:
    """Limited in rate backwards in time, in place: every move of the plan (H,) starts early enough to arrive."""
    for k in range(plan.size - 2, -1, -1):
        plan[k] = min(max(plan[k], plan[k + 1] - reach), plan[k + 1] + reach)


@njit(cache=True, error_model="numpy", nogil=True)
def postpone_half(plan: Any, u_last: float, reach: float) -> None:
    """The first jump of the plan (H,) later by half of the samples that it takes at the greatest rate, in place."""
    before = u_last
    for k in range(plan.size):
        jump = plan[k] - before
        if abs(jump) > reach:
            half = int(np.ceil(abs(jump) / reach)) // 2
            for j in range(k, min(k + half, plan.size)):
                plan[j] = before
            return
        before = plan[k]


@njit(cache=True, error_model="numpy", nogil=True)
def fill_candidates(plans: Any, targets: Any, remaining: Any, ramps: Any, u_last: float, reach: float) -> None:
    """The rows of `Candidates`, not yet clipped: five plans and `ramps` (M, H) from the last command.

    targets (2, H): the inverse within the box, and within the rate limit.
    """
    horizon, left = plans.shape[1], remaining.size
    for k in range(horizon):
        plans[0, k] = u_last
        plans[1, k] = targets[1, k]
        plans[2, k] = targets[0, k]
        plans[3, k] = targets[0, k]
        if left:
            plans[4, k] = remaining[min(k, left - 1)]
        else:
            plans[4, k] = targets[1, k]
    postpone_half(plans[3], u_last, reach)
    run_ahead(plans[2], reach)
    run_ahead(plans[3], reach)
    for n in range(ramps.shape[0]):
        for k in range(horizon):
            plans[5 + n, k] = u_last + ramps[n, k]


@njit(cache=True, error_model="numpy", nogil=True)
def costs(plans: Any, angles: Any, reference: Any, inverse: Any, u_last: float, tracking: Any, weights: Any) -> Any:
    """Costs (N,) of `PlanCost`, infinite where they are not finite; weights: rate, effort, soft limit, low, high."""
    rate, effort, soft, low, high = weights[0], weights[1], weights[2], weights[3], weights[4]
    found = np.empty(plans.shape[0])
    for n in range(plans.shape[0]):
        total, before = 0.0, u_last
        for k in range(plans.shape[1]):
            error, move, off = angles[n, k] - reference[k], plans[n, k] - before, plans[n, k] - inverse[k]
            total += tracking[k] * error * error + rate * move * move + effort * off * off
            if soft > 0.0:
                excess = max(angles[n, k] - high, 0.0) + max(low - angles[n, k], 0.0)
                total += soft * excess * excess
            before = plans[n, k]
        found[n] = total if np.isfinite(total) else np.inf
    return found
