"""Whether the device holds what it was sent: commands that do not reach it show in nothing else for a long time."""

from __future__ import annotations

import math
from collections import deque
from typing import final

_S = 1e-9


@final
class Followed:
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

    def judge(self, held: float, sent: float, now_ns: int) -> tuple[bool, str]:
        """Whether the device follows, and why the run has to stop, empty while it has not.

        Args:
            held: what the device says it holds; NaN where it does not tell.
            sent: command sent last; NaN before the first.
            now_ns: monotonic time now [ns].
        """
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
