"""Motions of piecewise constant jerk: limits, states of motion, pieces, and the angle along them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hystmpc.trials.config import Positive, Settings
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


class MotionLimitsSettings(Settings):
    """Block `limits` of a motion, and `motion` of a planner's controller: how fast a reference moves.

    Attributes:
        velocity_deg_s: greatest velocity of the reference [deg/s].
        acceleration_deg_s2: greatest acceleration of the reference [deg/s^2].
        jerk_deg_s3: greatest jerk of the reference [deg/s^3].
    """

    velocity_deg_s: Positive = MotionLimits.velocity_deg_s
    acceleration_deg_s2: Positive = MotionLimits.acceleration_deg_s2
    jerk_deg_s3: Positive = MotionLimits.jerk_deg_s3

    def build(self) -> MotionLimits:
        """The limits."""
        return MotionLimits(self.velocity_deg_s, self.acceleration_deg_s2, self.jerk_deg_s3)


@dataclass(frozen=True)
class Kinematics:
    """A state of motion: angle [deg], velocity [deg/s], acceleration [deg/s^2]."""

    theta_deg: float
    velocity_deg_s: float = 0.0
    acceleration_deg_s2: float = 0.0


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
