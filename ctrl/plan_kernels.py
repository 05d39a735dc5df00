"""Compiled arithmetic on plans: limits, candidates, costs and the condensed program; compiled at the first call."""

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


@njit(cache=True, error_model="numpy", nogil=True)
def condense(jacobian: Any, error: Any, tracking: Any, moves: Any, off: Any, weights: Any, hessian: Any) -> Any:
    """The gradient (H,) and, in place, the upper triangle (H (H + 1) / 2,), column by column, of `TrackingQp`.

    jacobian (H, H) is lower triangular; moves = D p - e_1 u_last and off = p - f, each (H,); weights: rate, effort.
    """
    size, at = error.size, 0
    rate, effort = 2.0 * weights[0], 2.0 * weights[1]
    gradient = np.empty(size)
    for i in range(size):
        total = effort * off[i] + rate * moves[i]
        if i + 1 < size:
            total -= rate * moves[i + 1]
        for j in range(i + 1):
            hessian[at + j] = 0.0
        for k in range(i, size):
            weighted = 2.0 * tracking[k] * jacobian[k, i]
            total += weighted * error[k]
            for j in range(i + 1):
                hessian[at + j] += weighted * jacobian[k, j]
        hessian[at + i] += effort + (2.0 * rate if i + 1 < size else rate)
        if i:
            hessian[at + i - 1] -= rate
        gradient[i] = total
        at += i + 1
    return gradient


@njit(cache=True, error_model="numpy", nogil=True)
def rate_multipliers(gradient: Any, moves: Any, reach: float) -> Any:
    """Multipliers (H,) that hold a plan where it already moves at the greatest rate; see `TrackingQp`."""
    found = np.zeros(gradient.size)
    balance, touching = 0.0, reach * (1.0 - 1e-6)
    for k in range(gradient.size - 1, -1, -1):
        balance -= gradient[k]
        if moves[k] >= touching:
            found[k] = max(balance, 0.0)
        elif moves[k] <= -touching:
            found[k] = min(balance, 0.0)
    return found


@njit(cache=True, error_model="numpy", nogil=True)
def block_columns(jacobian: Any, blocking: Any, starts: Any, found: Any) -> None:
    """J M (H, m) in place: lower triangular J (H, H) times `MoveBlocking.matrix`, whose column b is zero before
    `starts[b]` and after the end of block b + 1, but for the last.
    """
    horizon, count = blocking.shape
    for b in range(count):
        stop = starts[b + 2] if b + 2 < count else horizon
        for k in range(horizon):
            total = 0.0
            for i in range(starts[b], min(k + 1, stop)):
                total += jacobian[k, i] * blocking[i, b]
            found[k, b] = total


@njit(cache=True, error_model="numpy", nogil=True)
def condense_blocked(columns: Any, starts: Any, weighted: Any, constant: Any, gradient: Any, hessian: Any) -> None:
    """Gradient (m,) += 2 (J M)'Q e and the upper triangle, column by column, of `constant` + 2 (J M)'Q J M, in place.

    columns: J M (H, m); weighted (2, H): 2 Q, and 2 Q e.
    """
    horizon, count = columns.shape
    at = 0
    for b in range(count):
        for k in range(starts[b], horizon):
            gradient[b] += weighted[1, k] * columns[k, b]
        for a in range(b + 1):
            total = constant[a, b]
            for k in range(starts[b], horizon):
                total += weighted[0, k] * columns[k, a] * columns[k, b]
            hessian[at] = total
            at += 1


@njit(cache=True, error_model="numpy", nogil=True)
def block_room(moves: Any, starts: Any, ends: Any, reach: float, low: Any, high: Any, extreme: Any) -> None:
    """How far the move of a block's last deviation may differ from that of the one before, both (m,), in place.

    The deviation's move is the same in all samples of a block: those of the plan that move most leave the least room.
    extreme: the move of the plan (m,) nearest to a limit. The plan is admissible but for rounding, so zero always is.
    """
    for b in range(starts.size):
        least, most = moves[starts[b]], moves[starts[b]]
        for k in range(starts[b] + 1, ends[b] + 1):
            least, most = min(least, moves[k]), max(most, moves[k])
        length = ends[b] + 1 - starts[b]
        low[b] = length * min(-reach - least, 0.0)
        high[b] = length * max(reach - most, 0.0)
        extreme[b] = most if most >= -least else least
