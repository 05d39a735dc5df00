"""The rod device's friction law solved from the tip to the drive: slower than Newton, and it always arrives.

From the tip on, everything is explicit. Let tau_j be the tension of span j, or where it is slack, minus what it lacks
to be taut, over its compliance. With tau_j and the displacement s_{j+1} of its far end known, the span gives s_j, and
contact j gives the tension behind it, by a = exp(mu phi_j) and the drag h_j:

    s_j above where it was:   tau_{j-1} = a max(tau_j, 0) + h_j                       it slips towards the drive
    s_j where it was:         tau_{j-1} from max((tau_j - h_j) / a, 0) up to that     it sticks
    s_j below:                tau_{j-1} = (tau_j - h_j) / a, as far as tau_j >= h_j   it slips towards the tip
    thereafter:               tau_{j-1} < 0, s_j stays                                the piece behind it is slack

So all solutions of the part beyond contact j lie on one curve (s_j, tau_j) that rises in both, along which a number
sigma counts. A contact puts in the stretch in which it sticks and the one in which it is loose; where these begin are
its knots, one after another from the tip. The last root is that of s_0 = the drive's place. Without any drag a slack
tendon may lie anywhere; the curve takes what vanishing drag leaves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

from .rod_equations import RodNumbers, StepNumbers, grip

_UP, _STICKS, _DOWN, _LOOSE = 1, 0, -1, -2
_ROUNDS = 400  # doubles are exhausted long before
_EXACT = 1e-13  # [mm or N]


class Knots(NamedTuple):
    """Where each contact changes its way, by contact 0..m (entry 0 unused), and room for one evaluation."""

    sticks: Any  # (m + 1,) sigma below which it no longer sticks, of the curve beyond it
    width: Any  # (m + 1,) of sigma in which it sticks [N]
    loose: Any  # (m + 1,) sigma below which the piece behind it is slack
    least: Any  # (m + 1,) tension behind it at `sticks` [N]
    way: Any  # (m + 1,) of the evaluation
    given: Any  # (m + 1,) tau behind a contact that sticks or is loose


def new_knots(contacts: int) -> Knots:
    """Room for that many contacts."""
    return Knots(*(np.zeros(contacts + 1) for _ in range(6)))


@njit(cache=True, error_model="numpy", inline="always")
def _stretch(tau: float, load: float, reached: float, j: int, p: RodNumbers, d: StepNumbers) -> Any:
    """Stretch s_j - s_{j+1} and bend of span j at tau, and their slopes: the inverse of `rod_equations.span`."""
    if j <= p.shaft_contacts:
        return p.compliance[j] * tau, 0.0, p.compliance[j], 0.0
    late = p.branch_stiffness[0] * (1 - d.new[0]) + p.branch_stiffness[1] * (1 - d.new[1])
    moment, whole = load + p.offset * max(tau, 0.0), p.stiffness + late
    bend = (moment + p.stiffness * (p.rest + p.set_share * (reached - p.rest))) / whole
    if bend > reached:
        soft = p.stiffness * (1 - p.set_share)
        whole = soft + late
        bend = (moment + soft * p.rest) / whole
    further = p.offset / whole if tau > 0 else 0.0
    return p.compliance[j] * tau + p.offset * (bend - p.rest), bend, p.compliance[j] + p.offset * further, further


@njit(cache=True, error_model="numpy")
def _at(sigma: float, near: int, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers) -> Any:
    """Set s_near..s_m from `sigma` of the curve (s_near, tau_near); returns tau_near [N], and both slopes by sigma."""
    m = p.compliance.size - 1
    for j in range(near + 1, m + 1):
        if sigma >= k.sticks[j] + k.width[j]:
            k.way[j], sigma = _UP, sigma - k.width[j]
        elif sigma >= k.sticks[j]:
            k.way[j], k.given[j], sigma = _STICKS, k.least[j] + (sigma - k.sticks[j]), k.sticks[j]
        elif sigma >= k.loose[j]:
            k.way[j] = _DOWN
        else:
            k.way[j], k.given[j], sigma = _LOOSE, sigma - k.loose[j], k.loose[j]
    tau, tau_slope, slope, s[m + 1] = sigma, 1.0, 0.0, 0.0
    for j in range(m, near - 1, -1):
        stretch, bend, longer, further = _stretch(tau, w.load[j], w.reached[j], j, p, d)
        s[j], slope = s[j + 1] + stretch, slope + longer * tau_slope
        if j == near:
            break
        a = grip(j, bend, p)
        steep = p.mu * further * (1.0 if bend > 0 else -1.0)  # of a, over a
        if k.way[j] == _UP:
            tau_slope = a * (1.0 + steep * tau) * tau_slope if tau > 0 else 0.0
            tau = a * max(tau, 0.0) + p.drag[j]
        elif k.way[j] == _DOWN:
            tau = max(tau - p.drag[j], 0.0) / a
            tau_slope = tau_slope / a - tau * steep * tau_slope
        else:
            tau, tau_slope, slope = k.given[j], 1.0, 0.0
            if k.way[j] == _STICKS:
                s[j] = w.before[j]
    return tau, tau_slope, slope


@njit(cache=True, error_model="numpy")
def _root(
    wanted: float, of_place: bool, begin: float, near: int, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers
) -> float:
    """Sigma at which s_near, or tau_near, is `wanted`; both rise with it. Newton within brackets, else bisection."""
    low, high, at, reach, last = -np.inf, np.inf, begin, 1.0, np.inf
    for _ in range(_ROUNDS):
        tau, tau_slope, slope = _at(at, near, s, w, k, p, d)
        value, slope = (s[near] - wanted, slope) if of_place else (tau - wanted, tau_slope)
        if abs(value) <= _EXACT:
            break
        if value < 0:
            low = at
        else:
            high = at
        step = -value / slope if slope > 0 else np.inf
        if low < at + step < high and abs(step) < 0.5 * last:
            at, last = at + step, abs(step)
            continue
        last = np.inf
        if low == -np.inf or high == np.inf:
            at, reach = at - np.sign(value) * reach, 4 * reach
            continue
        at = 0.5 * (low + high)
        if not low < at < high:
            break
    return at


@njit(cache=True, error_model="numpy")
def shoot(place: float, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers) -> None:
    """Set the displacements s (m + 2,) and the sides of `w` to those after the drive has gone to `place`."""
    m, sigma = p.compliance.size - 1, 0.0
    for j in range(m, 0, -1):
        sigma = _root(w.before[j], True, sigma, j, s, w, k, p, d)
        tau = max(_at(sigma, j, s, w, k, p, d)[0], 0.0)
        a = grip(j, _stretch(tau, w.load[j], w.reached[j], j, p, d)[1], p)
        k.least[j] = max(tau - p.drag[j], 0.0) / a
        k.sticks[j], k.width[j], k.loose[j] = sigma, a * tau + p.drag[j] - k.least[j], sigma
        if tau > p.drag[j]:
            k.loose[j] = min(_root(p.drag[j], False, sigma, j, s, w, k, p, d), sigma)
    _at(_root(place, True, sigma, 0, s, w, k, p, d), 0, s, w, k, p, d)
    s[0] = place
    for j in range(1, m + 1):
        w.side[j] = k.way[j] if k.way[j] > _LOOSE else 0.0
