"""Motions of the study: three minutes of commands to identify from, and fresh references to follow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hystmpc.trajectories.identification import identification_motions
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trajectories.ruckig_ import MotionLimits
from hystmpc.trajectories.scan import SinusoidScan
from hystmpc.trajectories.trajectory import Chain, PreviewTable, Trajectory
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .device import DrawnPlant

SCANS_HZ = {"scan": 0.2, "fast_scan": 0.6}
_APPROACH_HOLD_S = 1.0
_HOLDS_S = (2.0, 4.0)
_WHOLE_SHARE = (0.5, 0.9)  # of the reachable angles that a reference takes
_SLOPE_SHARE = 0.35  # of the greatest speed that the fast scan may ask for
_RETURN, _REST_S = 0.3, 1.0  # share of the greatest speed on the way back to rest, and the rest there
_QUICK = 0.25  # of the full length


@dataclass(frozen=True, eq=False)
class CountedMotion:
    """A reference that begins with an approach.

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
        """Reference at the ends of the samples (N,) [deg]."""
        table = PreviewTable(self.trajectory, dt, 1)
        return np.array([table.value(k + 1) for k in range(table.steps)])


def recordings(plant: DrawnPlant, quick: bool = False) -> tuple[Trial, ...]:
    """Trials of three minutes in all at the device's rate, each from the rest after a reset.

    Steps and ramps with holds, one long hold, slow, middling and fast sines, and reversals at random.
    """
    limits, share = plant.device.limits, _QUICK if quick else 1.0
    random = np.random.default_rng([plant.device.seed, 1])
    return tuple(
        _recorded(plant.reseeded(int(random.integers(2**31))), motion, name)
        for name, motion in identification_motions(limits.upper, limits.rate, random, share)
    )


def _recorded(plant: DrawnPlant, motion: Trajectory, name: str) -> Trial:
    """Command and the angle measured at the end of the sample over which it was held; it ends with a way back to rest.

    The command keeps to the limit of its speed.
    """
    limits, dt = plant.device.limits, plant.dt
    asked = motion(dt * np.arange(round(motion.duration_s / dt) + 1, dtype=np.float64))
    back = np.arange(asked[-1], limits.lower, -_RETURN * limits.rate * dt)
    held = np.full(round(_REST_S / dt), limits.lower)
    command = limits.clip_plans(np.concatenate([asked, back, held]), plant.rest_command, dt)
    t = dt * np.arange(command.size, dtype=np.float64)
    plant.reset()
    angle = np.array([plant.apply(float(u)) for u in command])
    return Trial(np.round(t, 6), command, angle, units=Units(command=plant.command_unit), source=name)


def fresh_motions(plant: DrawnPlant, quick: bool = False) -> tuple[CountedMotion, ...]:
    """Point to point with holds, a scan and a fast scan, over ranges drawn within what the device reaches."""
    random = np.random.default_rng([plant.device.seed, 2])
    rest, reachable = plant.true_angle, plant.reachable_deg
    low, high = _range(random, reachable)
    moves = 2 if quick else 5
    targets = random.uniform(low, high, moves)
    holds = random.uniform(*_HOLDS_S, moves)
    limits = MotionLimits(velocity_deg_s=min(60.0, _SLOPE_SHARE * _speed(plant)))
    start = float(random.uniform(low, high))
    steps = PointToPoint(start, targets.tolist(), holds.tolist(), limits)
    motions = [_approached("point_to_point", rest, start, steps, limits)]
    for name, hz in SCANS_HZ.items():
        low, high = _range(random, reachable)
        amplitude = min(0.5 * (high - low), _SLOPE_SHARE * _speed(plant) / (2 * np.pi * hz))
        centre = 0.5 * (low + high)
        scan = SinusoidScan(centre - amplitude, centre, amplitude, hz, 1.0 if quick else float(round(10 * hz)))
        motions.append(_approached(name, rest, centre - amplitude, scan, limits))
    return tuple(motions)


def _range(random: np.random.Generator, reachable: tuple[float, float]) -> tuple[float, float]:
    whole = reachable[1] - reachable[0]
    width = float(random.uniform(*_WHOLE_SHARE)) * whole
    low = reachable[0] + float(random.uniform(0.05, 0.95)) * (whole - width)
    return low, low + width


def _speed(plant: DrawnPlant) -> float:
    """Mean slope times the greatest change of the command [deg/s]."""
    low, high = plant.reachable_deg
    limits = plant.device.limits
    return (high - low) / limits.upper * limits.rate


def _approached(name: str, rest: float, start: float, motion: Trajectory, limits: MotionLimits) -> CountedMotion:
    approach = PointToPoint(rest, (start,), (_APPROACH_HOLD_S,), limits)
    return CountedMotion(name, Chain((approach, motion)), approach.duration_s)
