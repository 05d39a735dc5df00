"""Random references within the reachable angles: moves with holds, and scans, each after an approach."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.types import Vec

from .motion import MotionLimits
from .point_to_point import PointToPoint
from .scan import SinusoidScan
from .trajectory import PreviewTable, Trajectory, TrajectoryChain

_APPROACH_HOLD_S = 1.0
_HOLDS_S = (2.0, 4.0)
_WHOLE_SHARE = (0.5, 0.9)  # of the reachable angles that a reference takes
_USUAL_DEG_S = MotionLimits().velocity_deg_s
_SCAN_S = 10.0


@dataclass(frozen=True, eq=False)
class CountedMotion:
    """Reference that begins with an approach.

    Attributes:
        approach_s: time before it counts [s].
    """

    name: str
    trajectory: Trajectory
    approach_s: float

    def first(self, dt: float) -> int:
        """Number of the first sample that counts."""
        return math.ceil(self.approach_s / dt)

    def wanted(self, dt: float) -> Vec:
        """Return the reference at the ends of the samples (N,) [deg]."""
        table = PreviewTable(self.trajectory, dt, 1)
        return np.array([table.value(k + 1) for k in range(table.steps)])


def drawn_motions(
    random: np.random.Generator,
    rest_deg: float,
    reachable_deg: tuple[float, float],
    speed_deg_s: float,
    scans_hz: Mapping[str, float],
    *,
    moves: int = 5,
    scan_s: float = _SCAN_S,
) -> tuple[CountedMotion, ...]:
    """Draw a point-to-point motion with holds, and a sinusoid of each frequency, over ranges within reachable angles.

    Args:
        rest_deg: angle from which every motion begins [deg].
        reachable_deg: least and greatest angle [deg].
        speed_deg_s: greatest speed of the references, by a smaller amplitude of sinusoids where needed [deg/s].
        scans_hz: frequency of each scan by its name [Hz].
        scan_s: duration of a scan, rounded to whole periods, at least one [s].

    Raises:
        TrajectoryError: if the reachable range is empty or the speed not positive.
    """
    low, high = _range(random, reachable_deg)
    targets = random.uniform(low, high, moves)
    holds = random.uniform(*_HOLDS_S, moves)
    limits = MotionLimits(velocity_deg_s=min(_USUAL_DEG_S, speed_deg_s))
    start = float(random.uniform(low, high))
    steps = PointToPoint(
        start_deg=start, targets_deg=tuple(targets.tolist()), holds_s=tuple(holds.tolist()), limits=limits
    )
    motions = [approached("point_to_point", rest_deg, start, steps, limits)]
    for name, hz in scans_hz.items():
        low, high = _range(random, reachable_deg)
        amplitude = min(0.5 * (high - low), speed_deg_s / (2 * np.pi * hz))
        centre = 0.5 * (low + high)
        scan = SinusoidScan(
            start_deg=centre - amplitude,
            centre_deg=centre,
            amplitude_deg=amplitude,
            frequency_hz=hz,
            cycles=max(float(round(scan_s * hz)), 1.0),
        )
        motions.append(approached(name, rest_deg, centre - amplitude, scan, limits))
    return tuple(motions)


def _range(random: np.random.Generator, reachable: tuple[float, float]) -> tuple[float, float]:
    whole = reachable[1] - reachable[0]
    width = float(random.uniform(*_WHOLE_SHARE)) * whole
    low = reachable[0] + float(random.uniform(0.05, 0.95)) * (whole - width)
    return low, low + width


def approached(
    name: str,
    rest_deg: float,
    start_deg: float,
    motion: Trajectory,
    limits: MotionLimits | None = None,
    dt_s: float | None = None,
) -> CountedMotion:
    """Return a motion preceded by a move from rest to its start and a hold there.

    Args:
        rest_deg, start_deg: ends of the move [deg].
        dt_s: sample time [s]; the approach lasts a whole number of samples.

    Raises:
        TrajectoryError: if an angle is not finite.
    """

    def approach_with(hold_s: float) -> PointToPoint:
        return PointToPoint(
            start_deg=rest_deg, targets_deg=(start_deg,), holds_s=(hold_s,), limits=limits or MotionLimits()
        )

    approach = approach_with(_APPROACH_HOLD_S)
    if dt_s is not None:
        approach = approach_with(_APPROACH_HOLD_S + (-approach.duration_s) % dt_s)
    return CountedMotion(name, TrajectoryChain((approach, motion)), approach.duration_s)
