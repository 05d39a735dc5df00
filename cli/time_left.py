"""Time left of a computation that tells which share of it is done."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import final

Pace = Sequence[tuple[float, float]]
"""Points (share of the steps, share of the time), rising from (0, 0) to (1, 1): how the steps take the time."""

EVEN: Pace = ((0.0, 0.0), (1.0, 1.0))

RISE_PER_S = 0.02
"""A time that is shown rises by this share of itself a second at most."""

_FALL_S = 3.0  # in which most of the way to a shorter estimate is gone
_LEAST_S, _LEAST_SHARE = 1.0, 0.01  # before which nothing is said


@final
class Steady:
    """A time left that is shown: it counts down, and follows its estimate without jumps."""

    def __init__(self) -> None:
        self._shown: float | None = None
        self._read = 0.0

    def show(self, wanted: float | None, now: float, stands: bool = False) -> float | None:
        """What to show for an estimate [s] at a time [s]; `stands` where the work rests, and nothing counts down."""
        gone, self._read = now - self._read, now
        if wanted is None or self._shown is None:
            self._shown = wanted
            return wanted
        before = self._shown if stands else max(self._shown - gone, 0.0)
        if wanted <= before:
            self._shown = wanted + (before - wanted) * math.exp(-gone / _FALL_S)
        else:
            self._shown = min(wanted, self._shown * (1 + RISE_PER_S * gone))
        return self._shown


@final
class TimeLeft:
    """Estimates the time left by the mean speed since the start.

    With elapsed time E and the share p of the time that has passed, E (1 - p) / p is left. The mean speed errs by the
    factor between the fastest and the slowest stage at most; the speed of the last seconds would jump at each stage.
    Between two tellings p goes on at that speed, as far as the last step was wide. Pauses do not count.

    Args:
        pace: share of the time by share of the steps, as measured; steps of one length where left out.
    """

    def __init__(self, pace: Pace = EVEN) -> None:
        self._steps, self._times = zip(*pace, strict=True)
        self._began: float | None = None
        self._paused = 0.0  # seconds in pauses that are over
        self._pause: float | None = None  # when the present one began
        self._done, self._share, self._at = 0.0, 0.0, 0.0  # shares of steps and time as told last; elapsed time then
        self._farthest = 0.0  # share of the time where a step as wide as the last one ends
        self._steady = Steady()

    def told(self, share: float, now: float) -> None:
        """A share of the steps, 0 to 1, is done at a time [s]; less than before begins a new count."""
        step = share - self._done
        if self._began is None or step < 0.0:
            self._began, self._paused, self._steady, step = now, 0.0, Steady(), 0.0
            self._pause = None if self._pause is None else now
        elif step == 0.0:
            return
        self._done, self._share, self._farthest = share, self._passed(share), self._passed(share + step)
        self._at = self._elapsed(now)

    def pause(self, now: float) -> None:
        """The work stands still, for something that is not part of it."""
        if self._pause is None:
            self._pause = now

    def go_on(self, now: float) -> None:
        """The work goes on."""
        if self._pause is not None:
            self._paused += now - self._pause
            self._pause = None

    def seconds(self, now: float) -> float | None:
        """What to show as the time left [s]; None as long as nothing is known."""
        return self._steady.show(self._estimate(now), now, self._pause is not None)

    def _passed(self, share: float) -> float:
        """Share of the time that has passed when a share of the steps is done."""
        k = min(max(bisect_right(self._steps, share), 1), len(self._steps) - 1)
        wide = self._steps[k] - self._steps[k - 1]
        way = min((share - self._steps[k - 1]) / wide, 1.0)
        return self._times[k - 1] + way * (self._times[k] - self._times[k - 1])

    def _estimate(self, now: float) -> float | None:
        elapsed = self._elapsed(now)
        if self._share >= 1.0:
            return 0.0
        if self._share < _LEAST_SHARE or elapsed < _LEAST_S or self._at <= 0.0:
            return None
        # No farther than the last step went: where a step takes longer, the mean speed falls.
        share = min(self._share * elapsed / self._at, self._farthest)
        return elapsed * (1.0 - share) / share

    def _elapsed(self, now: float) -> float:
        """Time since the start without the pauses [s]."""
        if self._began is None:
            return 0.0
        end = now if self._pause is None else self._pause
        return end - self._began - self._paused


def clock_words(seconds: float | None) -> str:
    """A time left as a bar shows it, no finer than an estimate is: 0:07, 0:35, 2:40; empty where it is not known."""
    if seconds is None:
        return ""
    for least, step in ((120.0, 10.0), (20.0, 5.0)):
        if seconds > least:
            seconds = step * math.ceil(seconds / step)
            break
    whole = math.ceil(seconds)
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
