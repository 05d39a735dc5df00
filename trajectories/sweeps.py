"""Building scans: sweeps about a centre, with the way from the start angle to the first turning point.

A sweep is entered at the turning point on the far side of the centre. So the way there is never shorter than the
amplitude, which leaves room to arrive with the sweep's own acceleration and without overshoot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .chain import Chain
from .checks import require_finite, require_positive
from .limits import MotionLimits
from .piecewise import PiecewiseCubic, ramp
from .ruckig_ import RestingState, move
from .trajectory import Trajectory, inside


@dataclass(frozen=True)
class Cosine:
    """theta(t) = centre + A cos(2 pi f t), from one turning point to another.

    Attributes:
        centre_deg: centre [deg].
        amplitude_deg: A [deg], negative where the sweep begins at its lower turning point.
        frequency_hz: f [Hz].
        duration_s: a multiple of half a period [s].
    """

    centre_deg: float
    amplitude_deg: float
    frequency_hz: float
    duration_s: float

    def __call__(self, t: ArrayLike) -> Vec:
        """Angle [deg] at `t` [s]."""
        phase = 2 * np.pi * self.frequency_hz * inside(t, self.duration_s)
        return np.asarray(self.centre_deg + self.amplitude_deg * np.cos(phase))


@dataclass(frozen=True)
class SweepPlan:
    """What every scan is made of, checked.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre of all sweeps [deg].
        amplitudes_deg: half the peak-to-peak angle of each sweep [deg].
        frequency_hz: of every sweep [Hz].
        cycles: periods per sweep, a multiple of one half.

    Raises:
        TrajectoryError: if a number is out of bounds or no amplitude is given.
    """

    start_deg: float
    centre_deg: float
    amplitudes_deg: Sequence[float]
    frequency_hz: float
    cycles: float

    def __post_init__(self) -> None:
        require_finite(start_deg=self.start_deg, centre_deg=self.centre_deg)
        require_positive(frequency_hz=self.frequency_hz, cycles=self.cycles)
        if not self.amplitudes_deg:
            raise TrajectoryError("amplitudes_deg: got none, expected at least 1")
        for k, amplitude in enumerate(self.amplitudes_deg):
            require_positive(**{f"amplitudes_deg[{k}]": amplitude})
        if (2 * self.cycles) % 1:
            raise TrajectoryError(
                f"cycles: got {self.cycles}, expected a multiple of 0.5, so that the sweep ends at a turning point"
            )

    @property
    def sides(self) -> list[tuple[float, float]]:
        """Side of the centre (+1 above, -1 below) on which each sweep begins and ends."""
        side, sides = (1.0 if self.start_deg <= self.centre_deg else -1.0), []
        for _ in self.amplitudes_deg:
            end = -side if (2 * self.cycles) % 2 else side
            sides.append((side, end))
            side = -end
        return sides

    @property
    def needed(self) -> MotionLimits:
        """Peak rates of the widest sinusoid: A w, A w^2, A w^3 with w = 2 pi f."""
        widest, omega = max(self.amplitudes_deg), 2 * np.pi * self.frequency_hz
        return MotionLimits(*(float(widest * omega**order) for order in (1, 2, 3)))


def sinusoid_sweeps(plan: SweepPlan, limits: MotionLimits | None) -> Trajectory:
    """Sinusoids, each reached by a jerk-limited move that ends with the sinusoid's own acceleration.

    Velocity and acceleration are continuous from start to end; the final turning point is then held.

    Args:
        plan: the sweeps.
        limits: of the moves between; None for the peak rates of the widest sinusoid.

    Raises:
        TrajectoryError: if the limits are below the sinusoid's own rates.
    """
    limits = _covering(limits, plan.needed)
    omega = 2 * np.pi * plan.frequency_hz
    at, parts = RestingState(plan.start_deg), list[Trajectory]()
    for amplitude, (begin, end) in zip(plan.amplitudes_deg, plan.sides, strict=True):
        turns = [
            RestingState(plan.centre_deg + side * amplitude, -side * float(amplitude * omega**2))
            for side in (begin, end)
        ]
        parts.append(PiecewiseCubic(move(at, turns[0], limits)))
        parts.append(Cosine(plan.centre_deg, begin * amplitude, plan.frequency_hz, plan.cycles / plan.frequency_hz))
        at = turns[1]
    return Chain(tuple(parts))


def _covering(limits: MotionLimits | None, needed: MotionLimits) -> MotionLimits:
    """The given limits if the sinusoid stays within them."""
    if limits is None:
        return needed
    for name in ("velocity_deg_s", "acceleration_deg_s2", "jerk_deg_s3"):
        if getattr(limits, name) < getattr(needed, name):
            raise TrajectoryError(
                f"limits: got {name} {getattr(limits, name):.6g}, expected at least {getattr(needed, name):.6g}, "
                "the peak rate of the widest sinusoid"
            )
    return limits


def triangle_sweeps(plan: SweepPlan, limits: MotionLimits | None) -> PiecewiseCubic:
    """Legs of half a period from turning point to turning point.

    Args:
        plan: the sweeps.
        limits: every leg is a jerk-limited move from rest to rest, so that the corners are round; None for
            straight legs with sharp corners, led in at the speed of the first sweep, 4 A f.

    Raises:
        TrajectoryError: if half a period is too short for a leg within the limits.
    """
    turns = _turning_points(plan)
    leg_s = 0.5 / plan.frequency_hz
    if limits is None:
        lead_s = abs(turns[0] - plan.start_deg) / (4 * plan.amplitudes_deg[0] * plan.frequency_hz)
        legs = [ramp(plan.start_deg, turns[0], lead_s)]
        legs += [ramp(a, b, leg_s) for a, b in pairwise(turns)]
    else:
        legs = [move(RestingState(plan.start_deg), RestingState(turns[0]), limits)]
        legs += [move(RestingState(a), RestingState(b), limits, leg_s) for a, b in pairwise(turns)]
    return PiecewiseCubic(np.vstack(legs))


def _turning_points(plan: SweepPlan) -> list[float]:
    """Angles of all corners, in order [deg]."""
    return [
        plan.centre_deg + amplitude * begin * (-1) ** leg
        for amplitude, (begin, _) in zip(plan.amplitudes_deg, plan.sides, strict=True)
        for leg in range(round(2 * plan.cycles) + 1)
    ]
