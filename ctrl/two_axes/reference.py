"""References of two axes on the controller's clock: synchronised moves, and functions of time or sampled angles."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from hystmpc.models.two_axes.model import AXES
from hystmpc.trajectories.motion import Kinematics, MotionLimits, Segments, hold
from hystmpc.trajectories.ruckig_ import move_together
from hystmpc.trials.errors import ControllerError, shown
from hystmpc.trials.types import Vec

from ..command import number_of, numbers_of
from ..estimation.observer import ANGLE_BOUND_DEG
from ..planner.reference import PiecewiseReference

Pair = tuple[Kinematics, Kinematics]
"""State of motion of both axes."""


class PlaneReference(ABC):
    """Reference angles of both axes over the controller's time; at rest from `end_s` [s] on, infinite for never."""

    end_s: float

    @abstractmethod
    def at(self, t: Vec) -> Vec:
        """Reference angles (N, 2) [deg] at the times `t` (N,) [s]."""

    @abstractmethod
    def motion(self, t: float) -> Pair:
        """State of motion of both axes at `t` [s], the start of a new motion."""


@final
class MovesReference(PlaneReference):
    """Moves through points, both axes ending each at the same time, and a hold at every point.

    Args:
        start: state of motion of both axes.
        points: angles (K, 2) [deg], K >= 1.
        holds_s: rest at each (K,) [s].
        limits: of each axis.
        start_s: start on the controller's clock [s].

    Raises:
        TrajectoryError: if no motion is found.
    """

    def __init__(self, start: Pair, points: Vec, holds_s: Vec, limits: MotionLimits, start_s: float) -> None:
        pieces: tuple[list[Segments], list[Segments]] = ([], [])
        for point, pause in zip(points.tolist(), holds_s.tolist(), strict=True):
            for one, segments, angle in zip(pieces, move_together(start, point, limits), point, strict=True):
                one += [segments, hold(angle, pause)]
            start = Kinematics(point[0]), Kinematics(point[1])
        self._axes = []
        for one, angle in zip(pieces, points[-1].tolist(), strict=True):
            rows = np.vstack(one)
            self._axes.append(PiecewiseReference(rows[rows[:, 0] > 0], angle, start_s))
        self.end_s = max(axis.end_s for axis in self._axes)

    def at(self, t: Vec) -> Vec:
        return np.stack([axis.at(t) for axis in self._axes], axis=1)

    def motion(self, t: float) -> Pair:
        return self._axes[0].motion(t), self._axes[1].motion(t)


@final
class FollowedReference(PlaneReference):
    """Reference given by a function of the seconds since it was set; speeds are backward differences, limited.

    Args:
        function: times (N,) [s] -> angles (N, 2) [deg]; it may raise, the step then holds.
        start_s: when it was set on the controller's clock [s].
        duration_s: when it comes to rest, counted from there [s].
        dt: sample time [s].
        limits: bounds of the differences.
    """

    def __init__(
        self, function: Callable[[Vec], Vec], start_s: float, duration_s: float, dt: float, limits: MotionLimits
    ) -> None:
        self._function, self._start, self._dt, self._limits = function, start_s, dt, limits
        self.end_s = start_s + duration_s

    def at(self, t: Vec) -> Vec:
        return self._function(np.maximum(t - self._start, 0.0))

    def motion(self, t: float) -> Pair:
        recent = self.at(t - self._dt * np.array([2.0, 1.0, 0.0]))
        fastest, steepest = self._limits.velocity_deg_s, self._limits.acceleration_deg_s2
        speeds = np.diff(recent, axis=0) / self._dt
        speed = np.clip(speeds[1], -fastest, fastest)
        bend = np.clip((speeds[1] - speeds[0]) / self._dt, -steepest, steepest)
        x, y = (Kinematics(float(recent[2, i]), float(speed[i]), float(bend[i])) for i in range(AXES))
        return x, y


def usable_points(points: Any, holds_s: Any) -> tuple[Vec, Vec]:
    """Points (K, 2) [deg] and holds (K,) [s].

    Raises:
        ControllerError: if they are none, counts differ, an angle is not finite or a hold is negative.
    """
    wanted, pauses = numbers_of(points), numbers_of(holds_s)
    usable = np.all(np.abs(wanted) <= ANGLE_BOUND_DEG) and np.all((pauses >= 0) & (pauses < math.inf))
    if wanted.ndim != AXES or not wanted.size or wanted.shape != (pauses.size, AXES) or not usable:
        raise ControllerError(
            f"target: got angles {shown(points, 60)} deg and holds {shown(holds_s, 40)} s, expected pairs (x, y) of "
            f"finite angles within {ANGLE_BOUND_DEG:.0f} deg, and a hold >= 0 for each"
        )
    return wanted, pauses


def followed(source: Any, dt: float) -> tuple[Callable[[Vec], Vec], float]:
    """Function of an array of times, and its duration [s], of whatever is to be followed.

    Args:
        source: a function of seconds, of an array (N,) to (N, 2) or of one number to (2,), perhaps with `duration_s`;
            or angles (T, 2) [deg] at the coming samples, the last of which is held.

    Raises:
        ControllerError: if it is neither, or does not answer with two finite angles.
    """
    if not callable(source):
        angles = numbers_of(source)
        if angles.ndim != AXES or angles.shape[1] != AXES or not angles.size or not _finite(angles):
            raise ControllerError(f"reference: got shape {angles.shape}, expected a function, or finite angles (T, 2)")
        times = dt * np.arange(1, len(angles) + 1)
        return lambda t: np.stack([np.interp(t, times, angles[:, i]) for i in range(AXES)], axis=1), float(times[-1])
    said = getattr(source, "duration_s", math.inf)
    duration = number_of(said)
    if duration is None or not duration >= 0:
        raise ControllerError(f"reference: got duration_s {shown(said)}, expected a number of seconds")
    return _vectorised(source, dt), duration


def _vectorised(source: Callable[..., Any], dt: float) -> Callable[[Vec], Vec]:
    times = dt * np.arange(3, dtype=np.float64)

    def at_once(t: Vec) -> Vec:
        return np.asarray(source(t), dtype=np.float64)

    def one_by_one(t: Vec) -> Vec:
        return np.array([np.asarray(source(float(x)), dtype=np.float64) for x in t])

    reason = ""
    for function in (at_once, one_by_one):
        try:
            tried = function(times)
        except Exception as error:  # noqa: BLE001 - a user's function may raise anything
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"[:120]
            continue
        if tried.shape == (times.size, AXES) and _finite(tried):
            return function
        reason = f"shape {tried.shape}"
    raise ControllerError(f"reference: the function answers {reason}, expected two finite angles [deg] for each time")


def _finite(angles: Vec) -> bool:
    return bool(np.all(np.abs(angles) <= ANGLE_BOUND_DEG))


def rest_at(angles_deg: Sequence[float], start_s: float) -> MovesReference:
    """Constant reference."""
    x, y = Kinematics(float(angles_deg[0])), Kinematics(float(angles_deg[1]))
    return MovesReference((x, y), np.array([angles_deg], dtype=np.float64), np.zeros(1), MotionLimits(), start_s)
