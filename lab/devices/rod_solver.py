"""The rod device in the form of c/rod.c, where its equations and their solution stand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hystmpc.trials.types import Vec

from ..library import laboratory

TOLERANCE_MM = 1e-9
"""Greatest residual of the friction law that a step may leave [mm]."""


class RodNumbers(NamedTuple):
    """Parameters in the form of the equations; lengths mm, forces N, angles rad, stiffness N mm/rad, arrays by span."""

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
    compliance: Vec  # (m + 1,) c_j [mm/N]
    wrap: Vec  # (m + 1,) constant wrap at contact j, shaft only; entry 0 is unused
    drag: Vec  # (m + 1,) h_j; entry 0 is unused
    shaft_contacts: int
    segments: int


class StepNumbers(NamedTuple):
    """Constants of a step of one length; z_b after a step is keep z_b + old q_before + new q_after."""

    keep: tuple[float, float]
    old: tuple[float, float]
    new: tuple[float, float]
    drive_share: float


def packed(p: RodNumbers, d: StepNumbers) -> Vec:
    """The one array that c/rod.c reads: scalars, compliance, wrap, and drag last."""
    elastic = (p.mu, p.offset, p.rest, p.stiffness, *p.branch_stiffness, p.set_share, p.pretension)
    scalars = (*elastic, p.weight, p.length, p.down, TOLERANCE_MM, *d.keep, *d.old, *d.new, d.drive_share)
    return np.concatenate([scalars, p.compliance, p.wrap, p.drag])


def rubbing(numbers: Vec, factor: float, contacts: int) -> Vec:
    """Packed numbers with friction and drag of m contacts multiplied by a factor."""
    changed = numbers.copy()
    changed[0] *= factor
    changed[-contacts - 1 :] *= factor
    return changed


def gravity(bends: Vec, moments: Vec, p: RodNumbers) -> None:
    """Moments (n,) of the segments' weights at their joints, each weight in the middle of its segment."""
    laboratory().rod_gravity(bends, moments, p.segments, p.weight, p.length, p.down)


def advance(
    state: Vec, commands: Vec, p: RodNumbers, numbers: Vec, parts: int, angle: Vec, drive: Vec, tension: Vec
) -> float:
    """Advance `state` through commands (T,), each in `parts` steps; outputs (T,). Returns the greatest residual [mm].

    State (1 + 2 m + 4 n,): drive, displacements at the contacts [mm], last slip direction of each (1, -1, or 0), bends,
    two branches, greatest bends [rad].

    Args:
        numbers: `packed`.
    """
    sizes, outputs = (p.shaft_contacts, p.segments), (angle, drive, tension)
    return float(laboratory().rod(state, commands, commands.size, parts, *sizes, numbers, *outputs))
