"""The last line before the device: hard limits on value and rate, measured from what the device holds."""

from __future__ import annotations

import math
from typing import final

from hystmpc.ctrl.limits import CommandLimits

_S = 1e-9
_SHORTEST = 0.1  # of a sample: time that two commands count as apart at least
_ROUNDING = 1e-9  # of the range: a conversion of units


@final
class Gate:
    """Admits commands within the limits on value and rate; nothing is admitted while it is not known what is held.

        u_k in [lower, upper],   |u_k - u_(k-1)| <= rate * min(max(t_k - t_(k-1), dt / 10), dt)

    u_(k-1) is the last command that really left, or, after `anchor`, the command that the device says it holds.

    Args:
        limits: of the device.
        dt_s: sample time dt [s].
    """

    def __init__(self, limits: CommandLimits, dt_s: float) -> None:
        self._limits, self._dt = limits, dt_s
        self._sent_ns: int | None = None
        self.anchored = False
        self.last = math.nan
        self.velocity = 0.0
        self.clipped = 0

    def anchor(self, held: float) -> bool:
        """Start from the command that the device holds, at rest; False, and nothing changes, beyond the limits."""
        low, high = self._limits.lower, self._limits.upper
        slack = _ROUNDING * (high - low)
        if not low - slack <= held <= high + slack:
            return False
        self.last, self.velocity, self._sent_ns, self.anchored = min(max(held, low), high), 0.0, None, True
        return True

    def lose(self) -> None:
        """It is not known any more what the device holds."""
        self.anchored = False
        self.velocity = 0.0

    def admissible(self, wanted: float, now_ns: int) -> float:
        """The admissible command nearest to the wanted one at monotonic time `now_ns` [ns]; never raises."""
        u = self._limits.clip(wanted, self.last, self._elapsed_s(now_ns))
        self.clipped += not abs(u - wanted) <= 1e-12
        return u

    def sent(self, u: float, now_ns: int) -> None:
        """The command `u` has really left at `now_ns` [ns]: the next one is measured from it."""
        self.velocity = (u - self.last) / self._dt
        self.last, self._sent_ns = u, now_ns

    def _elapsed_s(self, now_ns: int) -> float:
        """Time that the rate limit counts [s]: never more than a sample, so that a pause earns no jump."""
        if self._sent_ns is None:
            return self._dt
        return min(max(_S * (now_ns - self._sent_ns), _SHORTEST * self._dt), self._dt)
