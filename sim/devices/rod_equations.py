"""Equations of the rod device, compiled: one span of tendon with its bending segment, and the friction of one contact.

A tendon passes m contacts with its lumen: p in the shaft, then n at the entrances of the rod's segments. Span j lies
behind contact j, j = 0..m, span 0 before the first. With s_j the tendon's displacement in the lumen at contact j [mm]
(towards the drive; s_0 is the drive, s_{m+1} = 0 the tip), q_j the bend of the span's segment and T_j its tension:

    T_j = max(0, (s_j - s_{j+1} - r (q_j - rest_j)) / c_j)                        elastic, and it can only pull
    r T_j + G_j = K_0 (q_j - rest_j - set (R_j - rest_j)) + K_1 (q_j - z_1j) + K_2 (q_j - z_2j)
    R_j = the greatest q_j so far,  z_b' = (q - z_b) / tau_b                      set of the first flexure, relaxation
    T_{j-1} <= T_j exp(mu phi_j) + h_j,  with equality where the tendon slips towards the drive
    T_j <= T_{j-1} exp(mu phi_j) + h_j,  with equality where it slips towards the tip, and no slip otherwise

phi_j is the wrap angle at the contact: a constant share of the shaft's bend, or |q_j|. With h = 0 the last two are the
capstan equation of Euler and Eytelwein; h is the drag of a contact load that does not come from the tension.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

_UP, _STICKS, _DOWN, _LOOSE = 1, 0, -1, -2
_ROUNDS = 400  # doubles are exhausted long before
_EXACT = 1e-13  # [mm or N]


class RodNumbers(NamedTuple):
    """Parameters as the equations read them; lengths mm, forces N, angles rad, stiffness N mm/rad, arrays by span."""

    shaft_contacts: int
    segments: int
    compliance: Any  # (m + 1,) c_j [mm/N]
    wrap: Any  # (m + 1,) constant wrap at contact j, shaft only; entry 0 is unused
    drag: Any  # (m + 1,) h_j; entry 0 is unused
    mu: float
    offset: float  # r
    rest: float  # natural bend of one segment
    stiffness: float  # K_0
    branch_stiffness: tuple[float, float]  # K_1, K_2
    set_share: float
    pretension: float  # drive displacement of the untensioned tendon, below 0 of the command
    weight: float  # of one segment
    length: float  # of one segment
    down: float  # angle from the base's axis to the pull of gravity


class StepNumbers(NamedTuple):
    """Constants of a step of one length; z_b after a step is keep z_b + old q_before + new q_after."""

    keep: tuple[float, float]
    old: tuple[float, float]
    new: tuple[float, float]
    drive_share: float


@njit(cache=True, error_model="numpy", inline="always")
def span(stretch: float, load: float, reached: float, j: int, p: RodNumbers, d: StepNumbers) -> Any:
    """Tension, bend, and their derivatives by `stretch` = s_j - s_{j+1}, of span j.

    `load` is the moment that does not come from bend or tendon now: gravity and what the Maxwell branches remember.
    """
    if j <= p.shaft_contacts:
        slope = 1.0 / p.compliance[j]
        return (slope * stretch, 0.0, slope, 0.0) if stretch > 0 else (0.0, 0.0, 0.0, 0.0)
    late = p.branch_stiffness[0] * (1 - d.new[0]) + p.branch_stiffness[1] * (1 - d.new[1])
    whole = p.stiffness + late
    free = (load + p.stiffness * (p.rest + p.set_share * (reached - p.rest))) / whole  # bend at no tension
    slope = 1.0 / (p.compliance[j] + p.offset * p.offset / whole)
    tension = slope * (stretch - p.offset * (free - p.rest))
    bend = free + p.offset * max(tension, 0.0) / whole
    if bend > reached:  # the set grows with the bend: a softer law that meets the other at q = reached
        whole = p.stiffness * (1 - p.set_share) + late
        free = (load + p.stiffness * (1 - p.set_share) * p.rest) / whole
        slope = 1.0 / (p.compliance[j] + p.offset * p.offset / whole)
        tension = slope * (stretch - p.offset * (free - p.rest))
        bend = free + p.offset * max(tension, 0.0) / whole
    if tension <= 0:
        return 0.0, bend, 0.0, 0.0
    return tension, bend, slope, p.offset * slope / whole


@njit(cache=True, error_model="numpy", inline="always")
def grip(j: int, bend: float, p: RodNumbers) -> float:
    """exp(mu phi) of contact j; `bend` is that of span j."""
    return math.exp(p.mu * (p.wrap[j] if j <= p.shaft_contacts else abs(bend)))


@njit(cache=True, error_model="numpy")
def gravity(bends: Any, moments: Any, p: RodNumbers) -> None:
    """Moments (n,) of the segments' weights at their joints, each weight in the middle of its segment."""
    heading, across = 0.0, 0.0
    for i in range(p.segments):  # first pass: where the middle of each segment lies, across the pull of gravity
        heading += bends[i]
        across += 0.5 * p.length * math.sin(heading - p.down)
        moments[i] = across
        across += 0.5 * p.length * math.sin(heading - p.down)
    total, weights, joint = 0.0, 0.0, across
    for i in range(p.segments - 1, -1, -1):
        middle = moments[i]
        joint = 2 * middle - joint  # the segment's own entrance
        total += middle
        weights += 1.0
        moments[i] = -p.weight * (total - weights * joint)


class Knots(NamedTuple):
    """Direction changes of each contact, by contact 0..m (entry 0 unused), and room for one evaluation."""

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
