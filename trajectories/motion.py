"""Motions of piecewise constant jerk: settings, limits, states of motion, segments and their evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, ValidationError, model_validator

from hystmpc.trials.config import NotNegative, Positive, Settings
from hystmpc.trials.errors import ConfigError, TrajectoryError
from hystmpc.trials.types import Vec

from .trajectory import Trajectory, inside


class TrajectorySettings(Settings):
    """Base of the settings of trajectories, from YAML or from a program, also by position.

    Attributes:
        by_position: keys in the order of positions, where that is not the order of the fields.

    Raises:
        TrajectoryError: from a program, if a value is out of bounds; `parse` raises ConfigError.
    """

    by_position: ClassVar[tuple[str, ...]] = ()

    def __init__(self, *values: Any, **named: Any) -> None:
        keys = self.by_position or [key for key in type(self).model_fields if key != "kind"]
        given = {**dict(zip(keys, values, strict=False)), **named}
        if len(values) > len(keys):
            raise TypeError(f"{type(self).__name__}: got {len(values)} values, expected {', '.join(keys)}")
        try:
            super().__init__(**{key: getattr(value, "tolist", lambda v=value: v)() for key, value in given.items()})
        except ValidationError:
            try:
                self.parse(given, type(self).__name__)
            except ConfigError as error:
                raise TrajectoryError(str(error)) from None
            raise

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # blocks within blocks stay ConfigErrors


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError("expected lower <= upper")
    return bounds


Bounds = Annotated[tuple[float, float], AfterValidator(_ordered)]
NotNegativeBounds = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_ordered)]


class MotionLimits(TrajectorySettings):
    """Greatest absolute speed, acceleration and jerk of a tip-angle reference.

    The defaults let a tendon catheter be driven at the 6 mm/s that S2 (RA-L 2024, PMC11633443) used, at about
    10 deg/mm, with ramps of a few tenths of a second.

    Attributes:
        velocity_deg_s: greatest velocity of the reference [deg/s].
        acceleration_deg_s2: greatest acceleration of the reference [deg/s^2].
        jerk_deg_s3: greatest jerk of the reference [deg/s^3].
    """

    velocity_deg_s: Positive = 60.0
    acceleration_deg_s2: Positive = 300.0
    jerk_deg_s3: Positive = 3000.0

    def __str__(self) -> str:
        return f"{self.velocity_deg_s:g} deg/s, {self.acceleration_deg_s2:g} deg/s^2, {self.jerk_deg_s3:g} deg/s^3"


class MotionSettings(TrajectorySettings):
    """Base of the motions that YAML selects by the key `kind`."""

    def build(self, folder: Path | str = ".") -> Trajectory:
        """Return the trajectory; relative file names start at `folder`.

        Raises:
            TrajectoryError: if a file cannot be used, or no motion fits settings that are each valid.
        """
        raise NotImplementedError

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return the same motion with other settings, validated."""
        del deep
        return type(self)(**{**{key: getattr(self, key) for key in type(self).model_fields}, **(update or {})})


class PathMotion(MotionSettings):
    """Base of the motions that are trajectories, computed once as a path of simpler ones."""

    @cached_property
    def path(self) -> Trajectory:
        """Return the path of simpler trajectories."""
        raise NotImplementedError

    @property
    def duration_s(self) -> float:
        """Time from start to end [s]."""
        return self.path.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Tip angle [deg], or command [mm or bar], at `t` [s]."""
        return self.path(t)

    def build(self, folder: Path | str = ".") -> Self:
        del folder
        return self

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        try:
            self.path  # noqa: B018 - computed once, here
        except TrajectoryError as error:
            raise ValueError(str(error)) from None
        return self


@dataclass(frozen=True)
class Kinematics:
    """State of motion: angle [deg], velocity [deg/s], acceleration [deg/s^2]."""

    theta_deg: float
    velocity_deg_s: float = 0.0
    acceleration_deg_s2: float = 0.0


# One row per segment: duration [s], then theta, velocity, acceleration at its start, and its jerk.
Segments = NDArray[np.float64]


def hold(value: float, duration_s: float) -> Segments:
    """Return one segment of constant value, shape (1, 5)."""
    return np.array([[duration_s, value, 0.0, 0.0, 0.0]])


def ramp(start: float, end: float, duration_s: float) -> Segments:
    """Return one segment of constant velocity, shape (1, 5)."""
    return np.array([[duration_s, start, (end - start) / duration_s, 0.0, 0.0]])


def peak_rates(segments: Segments) -> tuple[float, float, float]:
    """Compute the greatest |velocity|, |acceleration| and |jerk| over all segments, exactly (vertices included)."""
    duration, _, v0, a0, jerk = segments.T
    vertex = np.clip(np.divide(-a0, jerk, out=np.zeros_like(jerk), where=jerk != 0), 0.0, duration)
    velocity = [v0 + a0 * s + jerk * s**2 / 2 for s in (np.zeros_like(duration), vertex, duration)]
    acceleration = [a0, a0 + jerk * duration]
    return float(np.abs(velocity).max()), float(np.abs(acceleration).max()), float(np.abs(jerk).max())


def end_state(segment: Vec) -> tuple[float, float, float]:
    """Compute value, velocity and acceleration at the end of one segment (5,)."""
    s, p, v, a, j = (float(x) for x in segment)
    return p + s * (v + s * (a / 2 + s * j / 6)), v + s * (a + s * j / 2), a + s * j


@dataclass(frozen=True, eq=False)
class PiecewiseCubic:
    """Piecewise cubic theta(t) = p + v s + a s^2/2 + j s^3/6 with s = t - t_i, the time since the start of segment i.

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
        # The row after the last segment holds its end value.
        object.__setattr__(self, "_rows", np.vstack((segments[:, 1:], (end_state(segments[-1])[0], 0.0, 0.0, 0.0))))

    @property
    def duration_s(self) -> float:
        """Sum of the durations [s]."""
        return float(self._knots[-1])

    def __call__(self, t: ArrayLike) -> Vec:
        """Return the values at `t` [s]."""
        time = inside(t, self.duration_s)
        piece = np.searchsorted(self._knots, time, side="right") - 1
        s, (p, v, a, j) = time - self._knots[piece], np.moveaxis(self._rows[piece], -1, 0)
        return p + s * (v + s * (a / 2 + s * j / 6))
