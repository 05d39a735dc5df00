"""Plausibility of motion: blocked tip, displaced sensor, wrong model, drive that does not follow."""

from __future__ import annotations

import ctypes
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np

from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.types import Vec

from ..axes import PerAxis, each, is_known, of_axis

_S = 1e-9
SMOOTH_S = 0.2
"""Time constant over which noise of the angle is averaged [s]."""

_ONWARD_SHARE, _REVERSED_SHARE = 0.3, 0.5  # default travel without motion, as a share of the command's range
_ANGLE_SHARE = 0.025  # of the sensor's plausible range


class PlausibilitySettings(Settings):
    """Block `plausibility`: greatest disagreement of commanded and measured motion before the run is stopped safely.

    Attributes:
        travel: the command has to travel this far, in its unit, while the angle stays within `moves_deg`. It has to be
            wider than the play of the device. Null takes half of the range of `limits`, and 30 % of it for travel in
            the direction of the last motion, in which no play is left.
        moves_deg: a smaller change of the angle counts as no motion; null takes 2.5 % of the sensor's plausible range.
        travel_s: the device may lag behind the command by this time constant: only the travel of the lagged command
            counts [s].
        model_error_deg: estimated disturbance (measured angle minus the model's) that counts as a disagreement; or the
            estimator's own limit, where that is lower.
        model_error_s: duration of a disagreement that stops the run.
        watch_motion: whether travel without motion stops a run or a recording.
        watch_direction: whether an angle that falls while the command rises, or the reverse, stops a closed loop.
        watch_model: whether a disagreement with the model stops a run.
    """

    travel: Positive | None = None
    moves_deg: Positive | None = None
    travel_s: Positive = 0.5
    model_error_deg: Positive = 20.0
    model_error_s: Positive = 1.0
    watch_motion: bool = True
    watch_direction: bool = True
    watch_model: bool = True

    def travel_of(self, command_range: float, onward: bool = False) -> float:
        """Implausible travel without angular motion for a command range; `onward`: in the last motion's direction."""
        return self.travel or (_ONWARD_SHARE if onward else _REVERSED_SHARE) * command_range

    def moves_of(self, angle_range_deg: float) -> float:
        """Least change of the angle that counts as motion, for the sensor's plausible range [deg]."""
        return self.moves_deg or _ANGLE_SHARE * angle_range_deg


class Watch(Protocol):
    """Interface of a monitor of commanded and measured motion, of one axis or of two."""

    def judge(self, angle_deg: PerAxis, command: PerAxis, now_ns: int) -> str:
        """Cause of a stop, empty without one."""
        ...


@final
class MotionWatch(Watch):
    """Monitor of commanded travel without angular motion, or with angular motion in the opposite direction.

    The angle is smoothed over 0.2 s. The command u is followed as a device of the slowest allowed lag would do:

        dv/dt = (u - v) / travel_s

    Since the angle has last moved by `moves_deg`, v has a least and a greatest value; a distance between them of
    `travel` is implausible. So is one of v beyond the farthest u that led there, in the direction of that motion: no
    play is left then. A motion of the angle against that of v adds to the opposed travel, one along with it ends it; it
    may not be `travel` either.

    Args:
        command_range: greatest minus least command of the limits [mm or bar].
        angle_range_deg: of the sensor's plausible range [deg].
        rises: whether the angle has to rise with the command: in a closed loop.
    """

    def __init__(
        self, settings: PlausibilitySettings, command_range: float, angle_range_deg: float, rises: bool = False
    ) -> None:
        self._on, self._lag_s = settings.watch_motion, settings.travel_s
        self._travel, self._onward = settings.travel_of(command_range), settings.travel_of(command_range, True)
        self._moves = settings.moves_of(angle_range_deg)
        self._opposes = self._travel if rises and settings.watch_direction else math.inf
        self._gain = math.inf if rises else 0.0  # its sign is that of the observed change of angle by command
        self._smooth = self._lagged = math.nan
        self._seen_ns = 0
        self._low = self._high = self._least = self._most = math.nan  # of angle and v since the last motion
        self._from_deg = self._from = math.nan  # angle and v at that motion
        self._lowest = self._highest = math.nan  # of u since then
        self._direction, self._engaged = 0, math.nan  # of that motion, and the farthest u that led there
        self._opposed = 0.0

    def judge(self, angle_deg: float, command: float, now_ns: int) -> str:
        """Cause of a stop, empty without one."""
        if math.isnan(command) or math.isnan(angle_deg):
            return ""
        elapsed_s, self._seen_ns = _S * max(now_ns - self._seen_ns, 0), now_ns
        self._smooth = _followed(self._smooth, angle_deg, elapsed_s / SMOOTH_S)
        self._lagged = _followed(self._lagged, command, elapsed_s / self._lag_s)
        angle, lagged = self._smooth, self._lagged
        self._lowest, self._highest = min(command, self._lowest), max(command, self._highest)
        if not max(self._high, angle) - min(self._low, angle) < self._moves:  # also true at first, where it is NaN
            return self._moved(angle, command, lagged)
        self._low, self._high = min(self._low, angle), max(self._high, angle)
        self._least, self._most = min(self._least, lagged), max(self._most, lagged)
        if not self._on or (self._most - self._least < self._travel and self._onward_travel < self._onward):
            return ""
        return (
            f"implausible: the command went from {self._least:.4g} to {self._most:.4g} and the angle stayed within "
            f"{self._low:.2f} to {self._high:.2f} deg; is the tip blocked, the sensor dislodged? Expected are "
            f"{self._moves:.3g} deg or more (plausibility.travel, plausibility.moves_deg)"
        )

    @property
    def _onward_travel(self) -> float:
        """Command travel in the direction of the last motion, counted from where the angle began to follow."""
        beyond = self._most - self._engaged if self._direction > 0 else self._engaged - self._least
        return beyond if self._direction else 0.0

    @property
    def still(self) -> float:
        """Travel of v since the last motion of the angle; 0 before the first angle."""
        travelled = self._most - self._least
        return 0.0 if math.isnan(travelled) else travelled

    def numbers(self) -> Mapping[str, float]:
        """Initial state of the same rule in C; `travel` -1 disables it, and Python checks every motion again."""
        return {
            "travel": min(self._travel, self._onward) if self._on else -1.0,
            "lag_s": self._lag_s,
            "moves": self._moves,
            "smooth_s": SMOOTH_S,
            "smooth": self._smooth,
            "lagged": self._lagged,
            "low": self._low,
            "high": self._high,
            "least": self._least,
            "most": self._most,
            "watched_ns": self._seen_ns,
        }

    def _moved(self, angle: float, command: float, lagged: float) -> str:
        """Update the state after a motion of the angle, with or against the command."""
        turned, travelled = angle - self._from_deg, lagged - self._from
        change = 0.0 if math.isnan(turned) else turned * travelled
        self._opposed = self._opposed + abs(travelled) if change < 0 else 0.0
        self._gain += change
        self._engage(turned * self._gain if self._gain else 0.0)
        self._low = self._high = self._from_deg = angle
        self._least = self._most = self._from = lagged
        self._lowest = self._highest = command
        if self._opposed < self._opposes:
            return ""
        return (
            f"implausible: the angle went by {turned:.2f} deg against the command, which travelled "
            f"{self._opposed:.4g}; does the angle fall as the command rises? (wire.angle_sign, "
            "plausibility.watch_direction)"
        )

    def _engage(self, rise: float) -> None:
        """Store the direction of an input motion and its farthest command; `rise` has its sign."""
        before, self._direction = self._direction, 1 if rise > 0 else -1 if rise < 0 else 0
        farther, command = (max, self._highest) if rise > 0 else (min, self._lowest)
        self._engaged = farther(self._engaged, command) if self._direction == before else command


def _followed(lagged: float, value: float, share: float) -> float:
    """First-order lag of a value after `share` time constants; the value itself at the first call."""
    return value if math.isnan(lagged) else lagged + (1.0 - math.exp(-share)) * (value - lagged)


@dataclass(frozen=True, eq=False)
class AxesFrame:
    """Coordinates in which one command moves one angle: w = M u, y = A^-1 theta.

    Attributes:
        mix: M (2, 2), travels by commands.
        unframe: the inverse of A (2, 2), angles of the axes by measured ones.
        spans: range of each travel.
    """

    mix: Vec
    unframe: Vec
    spans: tuple[float, float]

    @classmethod
    def of(cls, model: TwoAxisModel) -> AxesFrame:
        """Coordinates of the axes of a model, whose limits give the ranges."""
        x, y = (high - low for low, high, _ in model.travel_limits())
        return cls(model.matrix, np.linalg.inv(model.turn).astype(np.float64), (x, y))


@final
class PlaneWatch(Watch):
    """Monitors of the motion of two axes, each in the coordinates of the axes, see `AxesFrame`.

    A sample without one of both angles is not judged.

    Args:
        frame: of the device.
        angle_range_deg: plausible range of each angle [deg].
        closed_loop: as of `MotionWatch`.
    """

    def __init__(
        self, settings: PlausibilitySettings, frame: AxesFrame, angle_range_deg: float, closed_loop: bool = False
    ) -> None:
        self._frame = frame
        self._watches = [MotionWatch(settings, span, angle_range_deg, closed_loop) for span in frame.spans]

    def judge(self, angle_deg: PerAxis, command: PerAxis, now_ns: int) -> str:
        if not (is_known(angle_deg) and is_known(command)):
            return ""
        angles = (self._frame.unframe @ np.array(each(angle_deg))).tolist()
        travels = (self._frame.mix @ np.array(each(command))).tolist()
        parts = zip(self._watches, angles, travels, strict=True)
        causes = [watch.judge(angle, travel, now_ns) for watch, angle, travel in parts]
        return next((of_axis(cause, i, len(causes)) for i, cause in enumerate(causes) if cause), "")


@final
class ModelWatch:
    """Monitor of the model error: detects an estimated disturbance that is too large for too long.

    `limit_deg` is the bound of the estimator's disturbance; infinite without an estimator [deg].
    """

    def __init__(self, settings: PlausibilitySettings, limit_deg: float, dt_s: float) -> None:
        self._on = settings.watch_model
        self._bound = min(settings.model_error_deg, 0.99 * limit_deg)
        self._longest = settings.model_error_s / dt_s
        self._samples = 0

    def numbers(self) -> Mapping[str, float]:
        """Parameters and state of the same rule in C, which ends at half of the samples."""
        return {
            "departure_bound": self._bound if self._on else math.inf,
            "departures_most": max(math.floor(self._longest), 1),
            "departures": self._samples,
        }

    def judge(self, disturbance_deg: float) -> str:
        """Cause of a stop, empty without one; called once a sample."""
        self._samples = self._samples + 1 if self._on and abs(disturbance_deg) >= self._bound else 0
        if self._samples < self._longest:
            return ""
        return (
            f"implausible: the device is {disturbance_deg:.1f} deg off its model, at most {self._bound:g} deg are "
            "expected; is the tip blocked, the sensor dislodged, the model another device's? "
            "(plausibility.model_error_deg)"
        )


@final
class DriveFollowing:
    """Monitor of the drive: compares the reported held command with the recently sent commands.

    A device follows while its held command lies within the least and the greatest command of the last `window_s`, or
    between them and the commands lagged by `window_s`, within `tolerance`. A drive that is late or lags by as much is
    no fault, one that is behind by more is. Samples without a reported command change nothing.

    Args:
        tolerance: in the command's unit; None disables the check.
        window_s: length of the memory, and greatest duration of a deviation [s].
    """

    def __init__(self, tolerance: float | None, window_s: float) -> None:
        self._tolerance, self._window_ns = tolerance, round(1e9 * window_s)
        self._sent: deque[tuple[int, float]] = deque()
        self._lagged = math.nan
        self._off_ns: int | None = None

    def recent(self, dt_s: float, most: int) -> Mapping[str, Any]:
        """Recently sent commands, at most as many as the window has samples, for the same rule in C."""
        count = max(min(most, int(1e-9 * self._window_ns / dt_s)), 1)
        commands = [u for _, u in self._sent][-count:]
        return {
            "recent": (ctypes.c_double * most)(*commands),
            "recent_count": len(commands),
            "recent_next": len(commands) % count,
            "recent_most": count,
            "tolerance": -1.0 if self._tolerance is None else self._tolerance,
        }

    def judge(self, held: float, sent: float, now_ns: int) -> tuple[bool, str]:
        """Whether the device follows, and the cause of a stop, empty without one."""
        if math.isnan(sent):
            return True, ""
        low, high = self._allowed(sent, now_ns)
        if self._tolerance is None or math.isnan(held):
            return True, ""
        if low - self._tolerance <= held <= high + self._tolerance:
            self._off_ns = None
            return True, ""
        self._off_ns = now_ns if self._off_ns is None else self._off_ns
        since_ns = now_ns - self._off_ns
        if since_ns < self._window_ns:
            return False, ""
        return False, (
            f"the device does not follow: it holds {held:.4g}, sent were {low:.4g} to {high:.4g}, for "
            f"{_S * since_ns:.2f} s; do commands reach it?"
        )

    def _allowed(self, sent: float, now_ns: int) -> tuple[float, float]:
        window, elapsed_ns = self._sent, now_ns - self._sent[-1][0] if self._sent else 0
        self._lagged = _followed(self._lagged, sent, elapsed_ns / self._window_ns)
        window.append((now_ns, sent))
        while len(window) > 1 and window[1][0] <= now_ns - self._window_ns:
            window.popleft()  # the command in force at the start of the window is kept
        commands = [self._lagged, *(u for _, u in window)]
        return min(commands), max(commands)
