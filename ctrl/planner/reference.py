"""References on the controller's clock: immutable functions of time that can be replaced in mid-motion."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from hystmpc.trajectories.motion import Kinematics, MotionLimits, Segments
from hystmpc.trajectories.ruckig_ import move_to_rest
from hystmpc.trials.errors import ControllerError, shown
from hystmpc.trials.types import Vec

from ..command import number_of, numbers_of
from ..estimation.observer import ANGLE_BOUND_DEG


class Reference(ABC):
    """Reference angle over the controller's time; it comes to its final rest at `end_s` [s], infinite for never.

    `foreign`: whether it runs a user's code, which may take any time and is evaluated outside the lock.
    """

    end_s: float
    foreign: bool

    @abstractmethod
    def at(self, t: Vec) -> Vec:
        """Return the reference angles [deg] at the times `t` (N,) [s]."""

    @abstractmethod
    def motion(self, t: float) -> Kinematics:
        """Return angle, velocity and acceleration at `t` [s], the start of a new motion."""


@final
class PiecewiseReference(Reference):
    """Piecewise cubic reference theta(t) = p + v s + a s^2/2 + j s^3/6; at rest at `target_deg` after the last piece.

    Args:
        segments: rows of duration [s], p [deg], v [deg/s], a [deg/s^2], j [deg/s^3], shape (M, 5), M = 0 for a rest.
        start_s: when it starts on the controller's clock [s].
    """

    foreign = False

    def __init__(self, segments: Segments, target_deg: float, start_s: float) -> None:
        self._knots = start_s + np.concatenate(([0.0], np.cumsum(segments[:, 0])))
        self._rows = np.vstack((segments[:, 1:], (target_deg, 0.0, 0.0, 0.0)))
        self.end_s = float(self._knots[-1])

    def at(self, t: Vec) -> Vec:
        s, (p, v, a, j) = self._locate(t)
        return p + s * (v + s * (a / 2 + s * j / 6))

    def motion(self, t: float) -> Kinematics:
        s, (p, v, a, j) = self._locate(np.array([t]))
        values = p + s * (v + s * (a / 2 + s * j / 6)), v + s * (a + s * j / 2), a + s * j
        return Kinematics(*(float(value[0]) for value in values))

    def _locate(self, t: Vec) -> tuple[Vec, Vec]:
        time = np.maximum(t, self._knots[0])
        piece = np.searchsorted(self._knots, time, side="right") - 1
        return time - self._knots[piece], self._rows[piece].T


@final
class GivenReference(Reference):
    """Reference given by a function of the seconds since it was set.

    Velocity and acceleration, for a motion to a new target, are backward differences over one sample, limited.

    Args:
        function: times (N,) [s] since it was set -> angles (N,) [deg]; it may raise, the step then holds.
        start_s: when it was set on the controller's clock [s].
        duration_s: when it comes to rest, counted from there [s].
        limits: bounds of the differences.
    """

    def __init__(
        self,
        function: Callable[[Vec], Vec],
        start_s: float,
        duration_s: float,
        dt: float,
        limits: MotionLimits,
        foreign: bool,
    ) -> None:
        self.foreign = foreign
        self._function, self._start, self._dt, self._limits = function, start_s, dt, limits
        self.end_s = start_s + duration_s

    def at(self, t: Vec) -> Vec:
        return self._function(np.maximum(t - self._start, 0.0))

    def motion(self, t: float) -> Kinematics:
        recent = self.at(t - self._dt * np.array([2.0, 1.0, 0.0]))
        speeds = np.diff(recent) / self._dt
        fastest, steepest = self._limits.velocity_deg_s, self._limits.acceleration_deg_s2
        speed = float(np.clip(speeds[-1], -fastest, fastest))
        bend = float(np.clip((speeds[-1] - speeds[0]) / self._dt, -steepest, steepest))
        return Kinematics(float(recent[-1]), speed, bend)


@dataclass(frozen=True, eq=False)
class ReferenceRequest:
    """Requested reference whose start time and initial state of motion are not yet known."""

    plan: Callable[[Kinematics, float], Reference]  # state of motion and time [s] of the start, to the reference
    from_motion: bool  # whether the state of motion is used; False if the reference is followed as given

    def __call__(self, start: Kinematics, start_s: float) -> Reference:
        """Return the reference from the state of motion `start` at `start_s` [s] on."""
        return self.plan(start, start_s)


def rest_reference(theta_deg: float, start_s: float) -> PiecewiseReference:
    """Return a constant reference."""
    return PiecewiseReference(np.empty((0, 5)), theta_deg, start_s)


def waypoint_request(angles_deg: Sequence[float], holds_s: Sequence[float], limits: MotionLimits) -> ReferenceRequest:
    """Return the request of moves from angle to angle, each as fast as the limits allow and followed by its hold.

    Raises:
        ControllerError: if the counts differ, nothing is given, an angle is not finite or a hold is negative.
    """
    wanted, pauses = numbers_of(angles_deg), numbers_of(holds_s)
    usable = np.all(np.abs(wanted) <= ANGLE_BOUND_DEG) and np.all((pauses >= 0) & (pauses < math.inf))
    if wanted.ndim != 1 or not wanted.size or wanted.shape != pauses.shape or not usable:
        raise ControllerError(
            f"waypoints: got angles {shown(angles_deg, 60)} deg and holds {shown(holds_s, 60)} s, "
            f"expected as many of one as of the other, finite angles within {ANGLE_BOUND_DEG:.0f} deg and holds >= 0"
        )

    angles, holds = wanted.tolist(), pauses.tolist()

    def plan(start: Kinematics, t: float) -> Reference:
        pieces = []
        for angle, hold in zip(angles, holds, strict=True):
            pieces += [move_to_rest(start, angle, limits), np.array([[hold, angle, 0.0, 0.0, 0.0]])]
            start = Kinematics(angle)
        segments = np.vstack(pieces)
        return PiecewiseReference(segments[segments[:, 0] > 0], angles[-1], t)

    return ReferenceRequest(plan, from_motion=True)


def given_request(source: Any, dt: float, limits: MotionLimits) -> ReferenceRequest:
    """Return the request of a function of the seconds since it was set, or of angles (T,) [deg] at the coming samples.

    A function gets an array of times if it accepts one, else single numbers; an attribute `duration_s`, as of
    trajectories, is its end. The last angle of an array is held.

    Raises:
        ControllerError: if it is neither, or does not answer with finite angles.
    """
    foreign = callable(source)
    if foreign:
        said = getattr(source, "duration_s", math.inf)
        duration = number_of(said)
        if duration is None or not duration >= 0:
            raise ControllerError(f"reference: got duration_s {shown(said)}, expected a number of seconds")
        function = _vectorised(source, dt)
    else:
        function, duration = _sampled(source, dt)
    return ReferenceRequest(
        lambda start, t: GivenReference(function, t, duration, dt, limits, foreign), from_motion=False
    )


def _sampled(source: Any, dt: float) -> tuple[Callable[[Vec], Vec], float]:
    angles = numbers_of(source)
    if not angles.ndim:
        raise ControllerError(f"reference: got {shown(source)}, expected a callable or angles (T,)")
    if angles.ndim != 1 or not angles.size or not np.all(np.abs(angles) <= ANGLE_BOUND_DEG):
        raise ControllerError(f"reference: got shape {angles.shape}, expected (T,) finite angles [deg], T >= 1")
    times = dt * np.arange(1, angles.size + 1)
    return lambda t: np.interp(t, times, angles), float(times[-1])


def _vectorised(source: Callable[..., Any], dt: float) -> Callable[[Vec], Vec]:
    """`source` as a function of an array of times, tested on the first samples."""
    times = dt * np.arange(3, dtype=np.float64)

    def one_by_one(t: Vec) -> Vec:
        return np.array([float(source(float(x))) for x in t])

    for function in (lambda t: np.asarray(source(t), dtype=np.float64), one_by_one):
        try:
            tried = function(times)
        except Exception as error:  # noqa: BLE001 - a user's function may raise anything
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"[:150]
            continue
        if tried.shape == times.shape and np.all(np.abs(tried) <= ANGLE_BOUND_DEG):
            return function
        reason = shown(tried)
    raise ControllerError(f"reference: the callable answers {reason}, expected one finite angle [deg] for each time")
