"""Final limits of a command before it is sent: value, rate, and a known held command as the start."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import final

from hystmpc.ctrl.command import CommandLimits

from ..axes import PerAxis, each, in_words, is_known, is_near, spread, together
from .intake import Observation

_S = 1e-9
_SHORTEST = 0.1  # least counted time between two commands, as a share of a sample
_ROUNDING = 1e-9  # rounding of a unit conversion, as a share of the range
_STILL_NS = 80_000_000  # required rest of the held command before it is accepted
_STILL = 0.25  # permitted change during that time, as a share of the tolerance
_LONGEST_NS = 60_000_000_000  # longest motion of a device by itself
_IMPLAUSIBLE_NS = 2_000_000_000  # longest report of an inexplicable held command


@final
class Gate:
    """Limits of a command in value and rate; no command is admitted while the held command is unknown.

        u_k in [lower, upper],   |u_k - u_(k-1)| <= rate * min(max(t_k - t_(k-1), dt / 10), dt)

    u_(k-1) is the last command that was really sent or, after `anchor`, the command that the device reports as held.
    The limits are those of each axis; a command with another count of numbers is none, and the last one is held.

    Args:
        limits: of the command, or of both commands of two axes.
    """

    def __init__(self, limits: CommandLimits | tuple[CommandLimits, ...], dt_s: float) -> None:
        self._limits: tuple[CommandLimits, ...] = each(limits)
        self._dt = dt_s
        self._sent_ns: int | None = None
        self.anchored = False
        self.last = together(math.nan for _ in self._limits)
        self.velocity = together(0.0 for _ in self._limits)
        self.clipped = 0

    def anchor(self, held: PerAxis) -> bool:
        """Set the held command, at rest, as the start of the rate limit; no effect and False beyond the limits."""
        inside: list[float] = []
        for limits, one in zip(self._limits, spread(held, len(self._limits)), strict=True):
            slack = _ROUNDING * (limits.upper - limits.lower)
            if not limits.lower - slack <= one <= limits.upper + slack:
                return False
            inside.append(min(max(one, limits.lower), limits.upper))
        self.last, self._sent_ns, self.anchored = together(inside), None, True
        self.velocity = together(0.0 for _ in self._limits)
        return True

    def lose(self) -> None:
        """Mark the held command as unknown."""
        self.anchored = False
        self.velocity = together(0.0 for _ in self._limits)

    def admissible(self, wanted: PerAxis, now_ns: int) -> PerAxis:
        """Admissible command nearest to the requested one at monotonic time `now_ns` [ns]; never raises."""
        elapsed_s, requested = self._elapsed_s(now_ns), spread(wanted, len(self._limits))
        pairs = zip(self._limits, requested, each(self.last), strict=True)
        u = together([limits.clip(one, last, elapsed_s) for limits, one, last in pairs])
        self.clipped += not is_near(u, wanted, 1e-12)
        return u

    def numbers(self) -> Mapping[str, float] | None:
        """Initial state of the same limits in C; None before the first sent command, and for two axes."""
        if not self.anchored or self._sent_ns is None or len(self._limits) != 1:
            return None
        (one,) = self._limits
        limits = {"lower": one.lower, "upper": one.upper, "rate": one.rate}
        return {**limits, "dt_s": self._dt, "last": self.last, "gate_ns": self._sent_ns}

    def sent(self, u: PerAxis, now_ns: int) -> None:
        """Record the command `u`, sent at `now_ns` [ns], as the start of the next rate limit."""
        self.velocity = together([(new - old) / self._dt for new, old in zip(each(u), each(self.last), strict=True)])
        self.last, self._sent_ns = u, now_ns

    def _elapsed_s(self, now_ns: int) -> float:
        """Time counted by the rate limit [s]: never more than a sample, so that a pause permits no jump."""
        if self._sent_ns is None:
            return self._dt
        return min(max(_S * (now_ns - self._sent_ns), _SHORTEST * self._dt), self._dt)


@final
class Anchor:
    """Synchronisation of the gate with the device's held command, before the first command and after every gap.

    A gap is a time without commands longer than `gap_s` (a stalled loop, a suspended machine), a command that did not
    leave, or a device that does not hold the sent command. After it, nothing is sent until fresh readings report a held
    command that stands still, since a device on its way back to rest is left alone. Without a report for `silence_s`,
    nothing is sent any more, and the device's watchdog is left to act.

    Reports are not always true. Without a command for less than `watchdog_s` nothing can have led the device away from
    the last command: only that one, within `tolerance`, is a place to start from. Later the watchdog of the device may
    have acted: anything between the last command and the safe one is. A device that reports anything else for two
    seconds is left alone.

    A device that never reports its command is taken to hold the last command for `gap_s`, and never longer. Of two axes
    all of this holds for each command, and nothing is sent to either while one is unknown.

    Args:
        gate: to be anchored; anchored already where the user has declared the command of a silent device.
        tolerance: greatest deviation of the held command from the sent one, in the command's unit.
        gap_s: shortest time without commands that counts as a gap [s].
        silence_s: time without a fresh held command after which it is given up [s].
        safe: the safe command, to which the watchdog of the device may lead; NaN where it may lead anywhere.
        watchdog_s: longest time without commands after which that watchdog acts [s].
    """

    def __init__(
        self, gate: Gate, tolerance: float, gap_s: float, silence_s: float, safe: PerAxis, watchdog_s: float
    ) -> None:
        self._gate, self._tolerance, self._safe = gate, tolerance, safe
        self._gap_ns, self._silence_ns = round(gap_s / _S), round(silence_s / _S)
        self._watchdog_ns = round(watchdog_s / _S)
        self._recent: deque[tuple[int, PerAxis]] = deque()
        self._reports_held = False
        self._sent_ns: int | None = None
        self._lost_ns: int | None = None
        self._implausible_ns: int | None = None
        self._reported_ns = self._judged_ns = 0
        self.moved = ""
        self.given_up = ""

    def judge(self, seen: Observation, boot_ns: int) -> bool:
        """Whether a command may be sent in this sample.

        In the first sample after a gap, `moved` reports a held command other than the sent one. `given_up` is the
        reason for which no further command is sent. `boot_ns` is the present time, suspension included [ns].
        """
        self._reports_held = self._reports_held or is_known(seen.held)
        self._judged_ns = boot_ns
        self.moved = ""
        away = self._sent_ns is not None and boot_ns - self._sent_ns > self._gap_ns
        if self._gate.anchored and (away or not seen.follows):
            self._lose(boot_ns)
        if self._gate.anchored:
            return True
        self._lost_ns = boot_ns if self._lost_ns is None else self._lost_ns
        return self._anchored_at(self._at_rest(seen.held, boot_ns), boot_ns) or self._waits(boot_ns)

    def in_time(self, boot_ns: int) -> bool:
        """Whether the check of this sample is recent enough to send; otherwise the held command becomes unknown."""
        if boot_ns - self._judged_ns <= self._gap_ns:
            return True
        self._lose(boot_ns)
        return False

    def numbers(self) -> Mapping[str, float]:
        """Initial state of the same check in C."""
        return {"gap_ns": self._gap_ns, "judged_ns": self._judged_ns}

    def sent(self) -> None:
        """Record a sent command; the time without commands counts from the check that allowed it."""
        self._sent_ns = self._judged_ns

    def not_sent(self, boot_ns: int) -> None:
        """Record a command that may not have been sent; a reported held command then has to confirm it."""
        if self._reports_held:
            self._lose(boot_ns)

    def _lose(self, boot_ns: int) -> None:
        self._gate.lose()
        self._recent.clear()
        self._implausible_ns = None
        self._lost_ns = self._reported_ns = boot_ns

    def _at_rest(self, held: PerAxis, boot_ns: int) -> PerAxis:
        """Held command once it is at rest, NaN until then."""
        if not is_known(held):
            return math.nan
        self._reported_ns = boot_ns
        recent = self._recent
        recent.append((boot_ns, held))
        while len(recent) > 2 and recent[1][0] <= boot_ns - _STILL_NS:
            recent.popleft()  # the report in force at the start of the window is kept
        of_axes = zip(*(each(u) for _, u in recent), strict=True)
        still = all(max(values) - min(values) <= _STILL * self._tolerance for values in of_axes)
        return held if still and boot_ns - recent[0][0] >= _STILL_NS else math.nan

    def _anchored_at(self, held: PerAxis, boot_ns: int) -> bool:
        if not is_known(held) or not self._credible(held, boot_ns):
            return False
        before = self._gate.last
        if not self._gate.anchor(held):
            self.given_up = f"the device holds {in_words(held)}, which is beyond the limits"
            return False
        if is_known(before) and not is_near(held, before, self._tolerance):
            here, there = in_words(held, ".4g"), in_words(before, ".4g")
            self.moved = f"the device does not follow: it holds {here}, sent was {there}"
        self._lost_ns = self._implausible_ns = None
        return True

    def _credible(self, held: PerAxis, boot_ns: int) -> bool:
        """Whether the reported held command can follow from the last command or the device's watchdog."""
        last, sent_ns, tolerance = self._gate.last, self._sent_ns, self._tolerance
        if sent_ns is None:
            return True
        goal = self._safe if boot_ns - sent_ns >= self._watchdog_ns else last
        if not is_known(goal) or all(
            min(a, b) - tolerance <= one <= max(a, b) + tolerance
            for one, a, b in zip(each(held), each(last), each(goal), strict=True)
        ):
            return True
        self._implausible_ns = boot_ns if self._implausible_ns is None else self._implausible_ns
        if boot_ns - self._implausible_ns > _IMPLAUSIBLE_NS:
            self.given_up = (
                f"the device says that it holds {in_words(held, '.4g')}, to which nothing has led it; "
                f"sent was {in_words(last, '.4g')}"
            )
        return False

    def _waits(self, boot_ns: int) -> bool:
        """Refuse to send (always False); give the run up after too long a wait."""
        assert self._lost_ns is not None
        silent_ns = boot_ns - max(self._lost_ns, self._reported_ns)
        if silent_ns > self._silence_ns:
            self.given_up = self.given_up or f"the device has not told what it holds for {_S * silent_ns:.2f} s"
        elif boot_ns - self._lost_ns > _LONGEST_NS:
            self.given_up = self.given_up or f"the device has moved by itself for {_S * _LONGEST_NS:.0f} s"
        return False
