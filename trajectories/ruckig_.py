"""Jerk-limited moves by ruckig, scaled so that its absolute tolerances are harmless.

ruckig's tolerances are absolute: in degrees and seconds it silently plans no motion at all for 1e-10 deg, and extreme
limits leave them meaningless (compare ruckig#58, #86). So every move is planned in units of its own length L and of the
time (L / jerk)^(1/3), scaled back, and checked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import ruckig

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .motion import Kinematics, MotionLimits, Segments, end_state, hold, peak_rates

# Targets closer than this, relative to the angle, are the same target (ruckig#160: a move of some ulp fails).
_SNAP = 1e-12
# Relative excess over a limit that passes as rounding, and gap at the target, in units of the move.
_EXCESS, _GAP, _BRAKED_GAP = 1e-9, 1e-8, 1e-7
# Where distance and limits are integer multiples of each other, ruckig may find no motion; a small change avoids it.
_JERKS = (1.0, 1.0 - 1e-9, 1.0 - 1e-6)
# ruckig is made for durations up to 7600 of its units of time and may refuse longer ones (ruckig#109).
_LONGEST = 1000.0
# Attempts at a common duration, and by what share of it motions may end apart.
_ROUNDS, _TOGETHER = 4, 1e-6


def move(start: Kinematics, target: Kinematics, limits: MotionLimits, duration_s: float | None = None) -> Segments:
    """Compute the fastest move between two states of zero velocity, or the one that takes `duration_s`.

    It is checked to 1e-9 of the limits, and to 1e-8 of its length at the target.

    Returns:
        Segments of constant jerk, shape (M, 5); of shape (0, 5) where start and target are the same rest.

    Raises:
        TrajectoryError: if the move cannot be made within the limits or in the duration.
    """
    unit = abs(target.theta_deg - start.theta_deg)
    if unit <= _SNAP * max(1.0, abs(start.theta_deg)):
        return _stay(start, target, duration_s)
    scale, where = _units(unit, limits, duration_s or 0.0), _words(start, target)
    wanted = _problem(start, target, limits, scale, duration_s)
    segments = _planned(wanted, where)
    least_s = float(segments[:, 0].sum()) * scale[0]
    if duration_s is not None and least_s > duration_s * (1 + _EXCESS):
        raise TrajectoryError(f"{where}: got {duration_s:.6g} s, expected at least {least_s:.6g} s within {limits}")
    _check_limits(segments, wanted, where)
    _check_end(segments, wanted, _GAP, where)
    return _scaled(segments, scale, start)


def move_to_rest(
    start: Kinematics, target_deg: float, limits: MotionLimits, duration_s: float | None = None
) -> Segments:
    """Compute the fastest motion from `start` to rest at `target_deg`; if `start` exceeds a limit, it is braked first.

    With `duration_s` it takes at least so long: longer where ruckig finds no motion of that duration.

    The unit of length of a motion with initial velocity or acceleration is

        L = max(|distance|, |v|^(3/2) / jerk^(1/2), |a|^3 / jerk^2)

    Returns:
        Segments of constant jerk, shape (M, 5); of shape (0, 5) where `start` is that rest already.

    Raises:
        TrajectoryError: if ruckig finds no motion, or one that misses the target.
    """
    target, jerk = Kinematics(target_deg), limits.jerk_deg_s3
    speed, bend = abs(start.velocity_deg_s), abs(start.acceleration_deg_s2)
    unit = max(abs(target_deg - start.theta_deg), math.sqrt(speed**3 / jerk), bend**3 / jerk**2)
    if unit <= _SNAP * max(1.0, abs(start.theta_deg)):
        return np.empty((0, 5)) if duration_s is None else hold(target_deg, duration_s)
    scale, where = _units(unit, limits, duration_s or 0.0), _words(start, target)
    wanted = _problem(start, target, limits, scale, duration_s)
    segments = _planned(wanted, where)
    segments = segments[segments[:, 0] > 0]
    _check_end(segments, wanted, _BRAKED_GAP, where)
    return _scaled(segments, scale, start)


def move_together(starts: Sequence[Kinematics], targets_deg: Sequence[float], limits: MotionLimits) -> list[Segments]:
    """Motions of several axes to rest, each within the limits, that end at the same time: that of the slowest.

    Returns:
        Segments of each axis as of `move_to_rest`; all of shape (0, 5) where every axis rests at its target already.

    Raises:
        TrajectoryError: as `move_to_rest`, or if no common duration is found.
    """
    pairs = list(zip(starts, targets_deg, strict=True))
    moves = [move_to_rest(*pair, limits) for pair in pairs]
    longest = max(float(segments[:, 0].sum()) for segments in moves)
    if longest == 0:
        return moves
    for _ in range(_ROUNDS):
        moves = [move_to_rest(*pair, limits, longest) for pair in pairs]
        ends = [float(segments[:, 0].sum()) for segments in moves]
        if max(ends) - min(ends) <= _TOGETHER * longest:
            return moves
        longest = max(ends)
    raise TrajectoryError(f"moves: got no common end of the axes within {longest:.6g} s, expected other limits")


def _words(start: Kinematics, target: Kinematics) -> str:
    moving = f", begun at {start.velocity_deg_s:.6g} deg/s" if start.velocity_deg_s else ""
    return f"move from {start.theta_deg:.6g} to {target.theta_deg:.6g} deg{moving}"


def _stay(start: Kinematics, target: Kinematics, duration_s: float | None) -> Segments:
    """Hold without motion, which is only possible without acceleration."""
    if start.acceleration_deg_s2 or target.acceleration_deg_s2:
        raise TrajectoryError(f"move: start and target are both {start.theta_deg:.6g} deg, expected some distance")
    return hold(start.theta_deg, duration_s or 0.0)[: duration_s is not None]


def _units(unit: float, limits: MotionLimits, duration_s: float = 0.0) -> Vec:
    """Units (5,) of time, angle, velocity, acceleration and jerk of a move of length `unit` [deg]."""
    least = max(unit / limits.velocity_deg_s, duration_s) / _LONGEST
    tick = max((unit / limits.jerk_deg_s3) ** (1 / 3), least)
    return np.array([tick, unit, unit / tick, unit / tick**2, unit / tick**3])


def _problem(
    start: Kinematics, target: Kinematics, limits: MotionLimits, scale: Vec, duration_s: float | None = None
) -> ruckig.InputParameter:
    """Problem of ruckig from angle 0, in units of `scale`."""
    tick, angle, velocity, acceleration, jerk = scale
    wanted = ruckig.InputParameter(1)
    wanted.current_position = [0.0]
    wanted.current_velocity = [start.velocity_deg_s / velocity]
    wanted.current_acceleration = [start.acceleration_deg_s2 / acceleration]
    wanted.target_position = [(target.theta_deg - start.theta_deg) / angle]
    wanted.target_acceleration = [target.acceleration_deg_s2 / acceleration]
    wanted.max_velocity = [limits.velocity_deg_s / velocity]
    wanted.max_acceleration = [limits.acceleration_deg_s2 / acceleration]
    wanted.max_jerk = [limits.jerk_deg_s3 / jerk]
    if duration_s is not None:
        wanted.minimum_duration = duration_s / tick
    return wanted


def _planned(wanted: ruckig.InputParameter, where: str) -> Segments:
    """Motion in the scaled units, with the segment that brakes into the limits if there is one."""
    trajectory, problem, jerk = ruckig.Trajectory(1), "", wanted.max_jerk[0]
    for share in _JERKS:
        wanted.max_jerk = [share * jerk]
        try:
            ruckig.Ruckig(1).calculate(wanted, trajectory)
            break
        except (ruckig.RuckigError, ValueError) as error:
            # ValueError: the binding has no name for some of ruckig's negative results.
            problem = " ".join(str(error).split())
    else:
        raise TrajectoryError(f"{where}: ruckig finds none ({problem})")
    profile = trajectory.profiles[0][0]
    brake = profile.brake
    main = np.column_stack((profile.t, profile.p[:-1], profile.v[:-1], profile.a[:-1], profile.j))
    if not brake.duration > 0:
        return main
    return np.vstack((np.column_stack((brake.t, brake.p, brake.v, brake.a, brake.j)), main))


def _check_limits(segments: Segments, wanted: ruckig.InputParameter, where: str) -> None:
    """Refuse a result that exceeds a limit: ruckig's own checks are looser."""
    bounds = (wanted.max_velocity[0], wanted.max_acceleration[0], wanted.max_jerk[0])
    for name, got, bound in zip(("velocity", "acceleration", "jerk"), peak_rates(segments), bounds, strict=True):
        if not got <= bound * (1 + _EXCESS):
            raise TrajectoryError(f"{where}: planned {name} is {got / bound:.9g} of its limit, expected at most 1")


def _check_end(segments: Segments, wanted: ruckig.InputParameter, accepted: float, where: str) -> None:
    theta, velocity, acceleration = end_state(segments[-1])
    gap = max(
        abs(theta - wanted.target_position[0]),
        abs(velocity) / max(wanted.max_velocity[0], 1.0),
        abs(acceleration - wanted.target_acceleration[0]) / max(wanted.max_acceleration[0], 1.0),
    )
    if not gap <= accepted:
        raise TrajectoryError(f"{where}: the plan misses its target by {gap:.2g} of it, expected {accepted:g}")


def _scaled(segments: Segments, scale: Vec, start: Kinematics) -> Segments:
    """Segments in degrees and seconds, from the start of the move on."""
    segments *= scale
    segments[:, 1] += start.theta_deg
    return segments
