"""Whether commands, drive and angle agree: a blocked tip, a dislodged sensor, a drive that does not follow."""

from __future__ import annotations

import ctypes
import math
from collections import deque
from collections.abc import Mapping
from typing import Any, final

from hystmpc.ctrl.limits import Positive
from hystmpc.trials.config import Settings

_S = 1e-9
_SMOOTH_S = 0.2  # time constant over which noise of the angle is averaged
TRAVEL_SHARE = 0.3
"""Of the command's range: travel without motion that is implausible where nothing else is said."""

_ANGLE_SHARE = 0.025  # of the sensor's plausible range
_AT_ONCE = 1.5  # times `travel`: no time is given to a command that goes so far


class PlausibilitySettings(Settings):
    """Block `plausibility`: how far commanded and measured motion may disagree before the run is stopped safely.

    Attributes:
        travel: the command has to travel this far, in its unit, while the angle stays within `moves_deg`; null takes
            30 % of the range of `limits`. It has to be wider than the play of the device.
        moves_deg: an angle that moves by less than this counts as one that does not move; null takes 2.5 % of the
            sensor's plausible range.
        travel_s: how long that has to last once the command has travelled so far; longer than the lag of the device.
            One and a half times the travel is implausible at once.
        model_error_deg: the estimated disturbance (measured angle less the model's) that counts as a disagreement; or
            the estimator's own limit, where that is lower.
        model_error_s: how long it has to last.
        watch_motion: whether travel without motion stops a run or a recording.
        watch_model: whether a disagreement with the model stops a run.
    """

    travel: Positive | None = None
    moves_deg: Positive | None = None
    travel_s: Positive = 0.3
    model_error_deg: Positive = 20.0
    model_error_s: Positive = 1.0
    watch_motion: bool = True
    watch_model: bool = True


@final
class MotionWatch:
    """Finds commanded travel without angular travel.

    The angle is smoothed over 0.2 s. Since it has last moved by `moves_deg` the command has a least and a greatest
    value; a distance between them of `travel` or more for `travel_s` is implausible, or of 1.5 `travel` at once.

    Args:
        command_range: greatest less least command of the limits [mm or bar].
    """

    def __init__(self, settings: PlausibilitySettings, command_range: float, angle_range_deg: float) -> None:
        self._on, self._hold_ns = settings.watch_motion, settings.travel_s / _S
        self._travel = settings.travel or TRAVEL_SHARE * command_range
        self._moves = settings.moves_deg or _ANGLE_SHARE * angle_range_deg
        self._smooth, self._seen_ns = math.nan, 0
        self._low = self._high = self._least = self._most = math.nan
        self._since_ns: int | None = None

    def judge(self, angle_deg: float, command: float, now_ns: int) -> str:
        """Why the run has to stop, empty while it has not."""
        if not self._on or math.isnan(command) or math.isnan(angle_deg):
            return ""
        angle = self._smoothed(angle_deg, now_ns)
        if not max(self._high, angle) - min(self._low, angle) < self._moves:  # also true at first, where it is NaN
            self._low = self._high = angle
            self._least = self._most = command
            self._since_ns = None
            return ""
        self._low, self._high = min(self._low, angle), max(self._high, angle)
        self._least, self._most = min(self._least, command), max(self._most, command)
        if self._most - self._least < self._travel:
            return ""
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        at_once = self._most - self._least >= _AT_ONCE * self._travel
        if now_ns - self._since_ns < self._hold_ns and not at_once:
            return ""
        return (
            f"implausible: the command went from {self._least:.4g} to {self._most:.4g} and the angle stayed within "
            f"{self._low:.2f} to {self._high:.2f} deg; is the tip blocked, the sensor dislodged? Expected are "
            f"{self._moves:.3g} deg or more (plausibility.travel, plausibility.moves_deg)"
        )

    def numbers(self) -> Mapping[str, float]:
        """What the same rule in C begins with; `travel` -1 does not look, `since_ns` 0 is none."""
        return {
            "travel": self._travel if self._on else -1.0,
            "travel_at_once": _AT_ONCE * self._travel,
            "travel_hold_ns": self._hold_ns,
            "moves": self._moves,
            "smooth_s": _SMOOTH_S,
            "smooth": self._smooth,
            "low": self._low,
            "high": self._high,
            "least": self._least,
            "most": self._most,
            "watched_ns": self._seen_ns,
            "since_ns": self._since_ns or 0,
        }

    def _smoothed(self, angle: float, now_ns: int) -> float:
        share = 1.0 - math.exp(-_S * (now_ns - self._seen_ns) / _SMOOTH_S)
        self._smooth = angle if math.isnan(self._smooth) else self._smooth + share * (angle - self._smooth)
        self._seen_ns = now_ns
        return self._smooth


@final
class ModelWatch:
    """Finds a model that the device does not obey any more: a disturbance that is too large for too long.

    Args:
        limit_deg: bound of the estimator's disturbance; infinite without an estimator [deg].
    """

    def __init__(self, settings: PlausibilitySettings, limit_deg: float, dt_s: float) -> None:
        self._on = settings.watch_model
        self._bound = min(settings.model_error_deg, 0.99 * limit_deg)
        self._longest = settings.model_error_s / dt_s
        self._samples = 0

    def numbers(self) -> Mapping[str, float]:
        """What the same rule in C goes by, which ends at half of the samples."""
        bound = self._bound if self._on else math.inf
        return {
            "departure_bound": bound,
            "departures_most": max(math.floor(self._longest), 1),
            "departures": self._samples,
        }

    def judge(self, disturbance_deg: float) -> str:
        """Why the run has to stop, empty while it has not; called once a sample."""
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
    """Compares what the device says it holds with everything that was sent lately.

    A device follows while what it holds lies within the least and the greatest command of the last `window_s`, give or
    take `tolerance`: a slow drive or wire is no fault, one that is behind by more than `window_s` is.

    Args:
        tolerance: in the command's unit; None does not look.
        window_s: how far back, and how long it may go on [s].
    """

    def __init__(self, tolerance: float | None, window_s: float) -> None:
        self._tolerance, self._window_ns = tolerance, round(1e9 * window_s)
        self._sent: deque[tuple[int, float]] = deque()
        self._off_ns: int | None = None

    def recent(self, dt_s: float, most: int) -> Mapping[str, Any]:
        """The last commands that were sent, at most as many as the window has samples, for the same rule in C."""
        count = max(min(most, int(1e-9 * self._window_ns / dt_s)), 1)
        commands = [u for _, u in self._sent][-count:]
        recent = (ctypes.c_double * most)(*commands)
        tolerance = -1.0 if self._tolerance is None else self._tolerance
        next_ = len(commands) % count
        return {
            "recent": recent,
            "recent_count": len(commands),
            "recent_next": next_,
            "recent_most": count,
            "tolerance": tolerance,
        }

    def judge(self, held: float, sent: float, now_ns: int) -> tuple[bool, str]:
        """Whether the device follows, and why the run has to stop, empty while it has not."""
        if math.isnan(sent):
            return True, ""
        window = self._sent
        window.append((now_ns, sent))
        while len(window) > 1 and window[1][0] <= now_ns - self._window_ns:
            window.popleft()  # the one that was in force when the window begins stays
        if self._tolerance is None or math.isnan(held):
            return True, ""
        low, high = min(u for _, u in window), max(u for _, u in window)
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
