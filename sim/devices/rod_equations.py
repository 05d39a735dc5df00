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

from hystmpc.models.kernels.numba_ import njit


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
    """What a step of one length has of constants; z_b after a step is keep z_b + old q_before + new q_after."""

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
