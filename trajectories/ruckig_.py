"""Jerk-limited moves by ruckig, in units in which its absolute tolerances are harmless."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import ruckig
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .trajectory import inside, require_positive


@dataclass(frozen=True)
class MotionLimits:
    """Greatest speed, acceleration and jerk of a tip-angle reference, either way.

    The defaults let a tendon catheter be driven at the 6 mm/s that S2 (RA-L 2024, PMC11633443) used, at about
    10 deg/mm, with ramps of a few tenths of a second.

    Attributes:
        velocity_deg_s: [deg/s].
        acceleration_deg_s2: [deg/s^2].
        jerk_deg_s3: [deg/s^3].

    Raises:
        TrajectoryError: if a limit is not finite and positive.
    """

    velocity_deg_s: float = 60.0
    acceleration_deg_s2: float = 300.0
    jerk_deg_s3: float = 3000.0

    def __post_init__(self) -> None:
        require_positive(
            velocity_deg_s=self.velocity_deg_s,
            acceleration_deg_s2=self.acceleration_deg_s2,
            jerk_deg_s3=self.jerk_deg_s3,
        )

    def __str__(self) -> str:
        return f"{self.velocity_deg_s:g} deg/s, {self.acceleration_deg_s2:g} deg/s^2, {self.jerk_deg_s3:g} deg/s^3"


# One row per piece: duration [s], then theta, velocity, acceleration at its start, and its jerk.
Segments = NDArray[np.float64]


def hold(value: float, duration_s: float) -> Segments:
    """One piece that keeps `value`, shape (1, 5)."""
    return np.array([[duration_s, value, 0.0, 0.0, 0.0]])


def ramp(start: float, end: float, duration_s: float) -> Segments:
    """One piece of constant velocity, shape (1, 5)."""
    return np.array([[duration_s, start, (end - start) / duration_s, 0.0, 0.0]])


def peak_rates(segments: Segments) -> tuple[float, float, float]:
    """Greatest |velocity|, |acceleration| and |jerk| over all pieces, exactly (vertices included)."""
    duration, _, v0, a0, jerk = segments.T
    vertex = np.clip(np.divide(-a0, jerk, out=np.zeros_like(jerk), where=jerk != 0), 0.0, duration)
    velocity = [v0 + a0 * s + jerk * s**2 / 2 for s in (np.zeros_like(duration), vertex, duration)]
    acceleration = [a0, a0 + jerk * duration]
    return float(np.abs(velocity).max()), float(np.abs(acceleration).max()), float(np.abs(jerk).max())


def end_state(segment: Vec) -> tuple[float, float, float]:
    """Value, velocity and acceleration at the end of one piece (5,)."""
    s, p, v, a, j = (float(x) for x in segment)
    return p + s * (v + s * (a / 2 + s * j / 6)), v + s * (a + s * j / 2), a + s * j


@dataclass(frozen=True, eq=False)
class PiecewiseCubic:
    """theta(t) = p + v s + a s^2/2 + j s^3/6 with s = t - t_i, the time since the start of piece i.

    Attributes:
        segments: rows of duration [s], p [deg], v [deg/s], a [deg/s^2], j [deg/s^3], shape (M, 5).

    Raises:
        TrajectoryError: if a number is not finite, a duration is negative, or their sum is zero.
    """

    segments: Segments
    _knots: Vec = field(init=False, repr=False)
    _rows: Vec = field(init=False, repr=False)

    def __post_init__(self) -> None:
        segments = np.array(self.segments, dtype=np.float64)
        if segments.ndim != 2 or segments.shape[1] != 5 or not np.isfinite(segments).all():
            raise TrajectoryError(f"pieces: got shape {segments.shape}, expected finite numbers of shape (M, 5)")
        if (segments[:, 0] < 0).any() or segments[:, 0].sum() <= 0:
            raise TrajectoryError("motion of no duration: no target differs from the start and no hold is above 0 s")
        segments.setflags(write=False)
        object.__setattr__(self, "segments", segments)
        object.__setattr__(self, "_knots", np.concatenate(([0.0], np.cumsum(segments[:, 0]))))
        # The row after the last piece holds its end value.
        object.__setattr__(self, "_rows", np.vstack((segments[:, 1:], (end_state(segments[-1])[0], 0.0, 0.0, 0.0))))

    @property
    def duration_s(self) -> float:
        """Sum of the durations [s]."""
        return float(self._knots[-1])

    def __call__(self, t: ArrayLike) -> Vec:
        """Values at `t` [s]."""
        s, (p, v, a, j) = self._locate(t)
        return p + s * (v + s * (a / 2 + s * j / 6))

    def derivative(self, t: ArrayLike, order: int) -> Vec:
        """Velocity (order 1), acceleration (2) or jerk (3) at `t` [s]; at a knot that of the later piece.

        Raises:
            TrajectoryError: if the order is not 1, 2 or 3.
        """
        s, (_, v, a, j) = self._locate(t)
        if order == 1:
            return v + s * (a + s * j / 2)
        if order == 2:
            return a + s * j
        if order == 3:
            return j + 0 * s
        raise TrajectoryError(f"derivative: got order {order}, expected 1, 2 or 3")

    def _locate(self, t: ArrayLike) -> tuple[Vec, Vec]:
        """Time since the start of the piece, and its polynomial, for each `t`."""
        time = inside(t, self.duration_s)
        piece = np.searchsorted(self._knots, time, side="right") - 1
        return time - self._knots[piece], np.moveaxis(self._rows[piece], -1, 0)


# Targets closer than this, relative to the angle, are the same target (ruckig#160: a move of some ulp fails).
_SNAP = 1e-12
# Relative excess over a limit, and gap at the target, that pass as rounding.
_EXCESS = 1e-9
# Where distance and limits are whole multiples of each other, ruckig sometimes finds no motion; a hair beside it does.
_JERKS = (1.0, 1.0 - 1e-9, 1.0 - 1e-6)
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
