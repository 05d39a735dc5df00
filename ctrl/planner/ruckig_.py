"""Jerk-limited motion to rest from any state of motion, by ruckig.

The room `trajectories` plans whole motions from rest; a target that changes in mid-motion needs this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig
from numpy.typing import NDArray

from hystmpc.trials.errors import TrajectoryError

from .settings import TargetMotionSettings

# One row per piece: duration [s], then theta, velocity, acceleration at its start, and its jerk.
Segments = NDArray[np.float64]

_SNAP = 1e-12  # moves smaller than this, relative to the angle, are none (ruckig#160)
_LONGEST = 1000.0  # ruckig is made for durations up to 7600 of its units of time (ruckig#109)
# Where distance and limits are whole multiples of each other, ruckig sometimes finds no motion; a hair beside it does.
_JERKS = (1.0, 1.0 - 1e-9, 1.0 - 1e-6)
_GAP = 1e-7  # distance from the target, in units of the move, that passes as rounding


@dataclass(frozen=True)
class Kinematics:
    """A state of motion: angle [deg], velocity [deg/s], acceleration [deg/s^2]."""

    theta_deg: float
    velocity_deg_s: float = 0.0
    acceleration_deg_s2: float = 0.0


def move_to_rest(start: Kinematics, target_deg: float, limits: TargetMotionSettings) -> Segments:
    """Fastest motion from `start` to rest at `target_deg`; where `start` exceeds a limit, it is braked first.

    ruckig's tolerances are absolute; so it plans in units of the move's own length L and time (L / jerk)^(1/3), with

        L = max(|distance|, |v|^(3/2) / jerk^(1/2), |a|^3 / jerk^2)

    Args:
        start: where and how fast the motion is now.
        target_deg: angle of rest [deg].
        limits: greatest velocity, acceleration and jerk.

    Returns:
        Pieces of constant jerk, shape (M, 5); of shape (0, 5) where `start` is that rest already.

    Raises:
        TrajectoryError: if ruckig finds no motion, or one that misses the target.
    """
    distance, jerk = target_deg - start.theta_deg, limits.jerk_deg_s3
    speed, bend = abs(start.velocity_deg_s), abs(start.acceleration_deg_s2)
    unit = max(abs(distance), math.sqrt(speed**3 / jerk), bend**3 / jerk**2)
    if unit <= _SNAP * max(1.0, abs(start.theta_deg)):
        return np.empty((0, 5))
    tick = max((unit / jerk) ** (1 / 3), unit / limits.velocity_deg_s / _LONGEST)
    scale = np.array([tick, unit, unit / tick, unit / tick**2, unit / tick**3])
    segments = _planned(start, distance, limits, scale)
    end = _end(segments[-1])
    gap = max(abs(end[0] - distance / unit), abs(end[1]), abs(end[2]))
    if not gap <= _GAP:
        raise TrajectoryError(f"move to {target_deg:.6g} deg: the plan misses it by {gap:.2g} of {unit:.3g} deg")
    segments *= scale
    segments[:, 1] += start.theta_deg
    return segments


def _planned(start: Kinematics, distance: float, limits: TargetMotionSettings, scale: NDArray[np.float64]) -> Segments:
    """The motion from angle 0 in units of `scale`, the piece that brakes into the limits included."""
    _, angle, velocity, acceleration, jerk = scale
    wanted = ruckig.InputParameter(1)
    wanted.current_position, wanted.target_position = [0.0], [distance / angle]
    wanted.current_velocity = [start.velocity_deg_s / velocity]
    wanted.current_acceleration = [start.acceleration_deg_s2 / acceleration]
    wanted.max_velocity = [limits.velocity_deg_s / velocity]
    wanted.max_acceleration = [limits.acceleration_deg_s2 / acceleration]
    trajectory, problem = ruckig.Trajectory(1), ""
    for share in _JERKS:
        wanted.max_jerk = [share * limits.jerk_deg_s3 / jerk]
        try:
            ruckig.Ruckig(1).calculate(wanted, trajectory)
            break
        except (ruckig.RuckigError, ValueError) as error:
            problem = " ".join(str(error).split())
    else:
        raise TrajectoryError(f"move by {distance:.6g} deg from {start}: ruckig finds none ({problem})")
    profile: Any = trajectory.profiles[0][0]
    brake: Any = profile.brake
    main = np.column_stack((profile.t, profile.p[:-1], profile.v[:-1], profile.a[:-1], profile.j))
    first = np.column_stack((brake.t, brake.p, brake.v, brake.a, brake.j)) if brake.duration > 0 else main[:0]
    segments = np.vstack((first, main))
    return segments[segments[:, 0] > 0]


def _end(segment: NDArray[np.float64]) -> tuple[float, float, float]:
    """Angle, velocity and acceleration at the end of one piece (5,)."""
    s, p, v, a, j = (float(x) for x in segment)
    return p + s * (v + s * (a / 2 + s * j / 6)), v + s * (a + s * j / 2), a + s * j
