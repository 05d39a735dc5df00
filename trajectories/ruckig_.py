"""Jerk-limited moves by ruckig, in units in which its absolute tolerances are harmless."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ruckig

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .limits import MotionLimits
from .piecewise import Segments, end_state, hold, peak_rates

# Targets closer than this, relative to the angle, are the same target (ruckig#160: a move of some ulp fails).
_SNAP = 1e-12
# Relative excess over a limit, and gap at the target, that pass as rounding.
_EXCESS = 1e-9
_GAP = 1e-8
# ruckig is made for durations up to 7600 of its units of time and may refuse longer ones (ruckig#109).
_LONGEST = 1000.0


@dataclass(frozen=True)
class RestingState:
    """Angle [deg] and acceleration [deg/s^2] at a moment of no velocity."""

    theta_deg: float
    acceleration_deg_s2: float = 0.0


def move(start: RestingState, target: RestingState, limits: MotionLimits, duration_s: float | None = None) -> Segments:
    """Fastest move between two states of no velocity, or the one that takes `duration_s`.

    ruckig's tolerances are absolute: in degrees and seconds it silently plans no motion at all for 1e-10 deg, and
    extreme limits leave them meaningless (compare ruckig#58, #86). So every move is planned over the distance 1 with
    a unit of time near (distance / jerk)^(1/3), scaled back, and checked: limits to 1e-9, end state to 1e-8.

    Args:
        start, target: states at both ends.
        limits: greatest velocity, acceleration and jerk.
        duration_s: wanted duration [s]; None for the least.

    Returns:
        Pieces of constant jerk, shape (M, 5); of shape (0, 5) where start and target are the same rest.

    Raises:
        TrajectoryError: if the move cannot be made within the limits or in the duration.
    """
    distance = target.theta_deg - start.theta_deg
    if abs(distance) <= _SNAP * max(1.0, abs(start.theta_deg)):
        return _stay(start, target, duration_s)
    unit = abs(distance)
    tick = max(
        (unit / limits.jerk_deg_s3) ** (1 / 3),
        unit / limits.velocity_deg_s / _LONGEST,
        (duration_s or 0.0) / _LONGEST,
    )
    scale = np.array([tick, unit, unit / tick, unit / tick**2, unit / tick**3])
    wanted = _input(start, target, limits, scale, duration_s)
    where = f"move from {start.theta_deg:.6g} to {target.theta_deg:.6g} deg"
    segments = _calculate(wanted, where)
    least_s = float(segments[:, 0].sum()) * tick
    if duration_s is not None and least_s > duration_s * (1 + _EXCESS):
        raise TrajectoryError(f"{where}: got {duration_s:.6g} s, expected at least {least_s:.6g} s within {limits}")
    _check(segments, wanted, where)
    segments *= scale
    segments[:, 1] += start.theta_deg
    return segments


def _stay(start: RestingState, target: RestingState, duration_s: float | None) -> Segments:
    """No motion, which is only possible without acceleration."""
    if start.acceleration_deg_s2 or target.acceleration_deg_s2:
        raise TrajectoryError(f"move: start and target are both {start.theta_deg:.6g} deg, expected some distance")
    return hold(start.theta_deg, duration_s or 0.0)[: duration_s is not None]


def _input(
    start: RestingState,
    target: RestingState,
    limits: MotionLimits,
    scale: Vec,
    duration_s: float | None,
) -> ruckig.InputParameter:
    """The problem in units of `scale`: time, angle, velocity, acceleration, jerk."""
    tick, _, velocity, acceleration, jerk = scale
    wanted = ruckig.InputParameter(1)
    wanted.current_position = [0.0]
    wanted.current_acceleration = [start.acceleration_deg_s2 / acceleration]
    wanted.target_position = [float(np.sign(target.theta_deg - start.theta_deg))]
    wanted.target_acceleration = [target.acceleration_deg_s2 / acceleration]
    wanted.max_velocity = [limits.velocity_deg_s / velocity]
    wanted.max_acceleration = [limits.acceleration_deg_s2 / acceleration]
    wanted.max_jerk = [limits.jerk_deg_s3 / jerk]
    if duration_s is not None:
        wanted.minimum_duration = duration_s / tick
    return wanted


def _calculate(wanted: ruckig.InputParameter, where: str) -> Segments:
    """Plan in the scaled units; rows as in `Segments`."""
    trajectory = ruckig.Trajectory(1)
    try:
        ruckig.Ruckig(1).calculate(wanted, trajectory)
    except (ruckig.RuckigError, ValueError) as error:
        # ValueError: the binding has no name for some of ruckig's negative results.
        raise TrajectoryError(f"{where}: ruckig finds none ({' '.join(str(error).split())})") from None
    profile = trajectory.profiles[0][0]
    return np.column_stack((profile.t, profile.p[:-1], profile.v[:-1], profile.a[:-1], profile.j))


def _check(segments: Segments, wanted: ruckig.InputParameter, where: str) -> None:
    """Refuse a result that exceeds a limit or misses the target: ruckig's own checks are looser."""
    bounds = (wanted.max_velocity[0], wanted.max_acceleration[0], wanted.max_jerk[0])
    for name, got, bound in zip(("velocity", "acceleration", "jerk"), peak_rates(segments), bounds, strict=True):
        if not got <= bound * (1 + _EXCESS):
            raise TrajectoryError(f"{where}: planned {name} is {got / bound:.9g} of its limit, expected at most 1")
    theta, velocity, acceleration = end_state(segments[-1])
    gaps = (
        abs(theta - wanted.target_position[0]),
        abs(velocity) / bounds[0],
        abs(acceleration - wanted.target_acceleration[0]) / bounds[1],
    )
    if not max(gaps) <= _GAP:
        raise TrajectoryError(f"{where}: the plan misses its target by {max(gaps):.2g} of it, expected {_GAP:g}")
