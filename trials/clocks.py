"""Analysis of time stamps: sampling interval, unit, and wraps of a counter."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .types import Index, Mask, Vec

SECONDS = MappingProxyType({"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0})
"""Seconds per unit of a time signal; `d` are days, as in spreadsheets."""

UNIT_NAMES = MappingProxyType(
    {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "min": "minutes", "h": "hours", "d": "days"}
)

SLOWEST_HZ, FASTEST_HZ, UNUSUAL_HZ = 1.0, 1e5, 2e4
"""Rates outside the first two do not occur in closed loops of this field; those above the third are rare."""

_DATES = (20_000.0, 80_000.0)  # days since 1900 in spreadsheets: the years 1954 to 2119
_USUAL_HZ, _USUAL_S = 50.0, 2.0  # a rate, and a time between two reversals, that devices of this field have
_IN_DOUBT = 0.5  # powers of ten: two units with a smaller difference in plausibility are both named
_NEVER_TURNS_S = 1000.0  # between two reversals
_SAME = 1.5  # least clock step of a gap, in usual steps


@dataclass(frozen=True)
class Interval:
    """Bounds [s] of the sampling interval of an evenly sampled log."""

    least: float
    most: float

    @property
    def middle(self) -> float:
        """Middle of the bounds [s]."""
        return 0.5 * (self.least + self.most)

    @property
    def rate_hz(self) -> float:
        """Roundest sampling rate within the bounds [Hz]."""
        return plainest(1 / self.most, 1 / self.least if self.least > 0 else np.inf)


def plainest(least: float, most: float) -> float:
    """Number with the fewest significant digits, up to four, between two positive numbers."""
    middle = 0.5 * (least + most) if np.isfinite(most) else least
    rounded = [float(f"{middle:.{digits}e}") for digits in range(4)]
    return next((number for number in rounded if least <= number <= most), rounded[-1])


def interval_of(t: Vec) -> Interval | None:
    """Sample interval from stamps (T,) [s] that may repeat or run backwards; None without a forward step.

    The estimate uses the longest stretch without a step backwards or a gap. With a coarse clock, n samples between two
    changes of the stamp last n - 1 to n + 1 intervals. Otherwise the two ends are exact to the last digit. Jitter
    widens both bounds.
    """
    t = t[np.isfinite(t)]
    steps = np.diff(t)
    forward = steps[steps > 0]
    if not forward.size:
        return None
    whole = (steps >= 0) & (steps <= _SAME * float(np.median(forward)))
    starts, stops = runs(whole)
    longest = int(np.argmax(stops - starts))
    start, stop = int(starts[longest]), int(stops[longest])
    part, steps = t[start : stop + 1], steps[start:stop]
    edges = np.flatnonzero(steps > 0) + 1
    if edges.size == steps.size or edges.size < 3:
        duration = float(part[-1] - part[0])
        slack = _resolution(part) + 2 * float(np.std(steps)) if edges.size == steps.size else float(np.median(forward))
        return Interval(max(duration - slack, 0.0) / steps.size, (duration + slack) / steps.size)
    counts = np.diff(edges)
    slack = 1 + 2 * max(0.0, float(np.std(counts)) - 0.5)
    duration, count = float(part[edges[-1]] - part[edges[0]]), int(edges[-1] - edges[0])
    return Interval(duration / (count + slack), duration / max(count - slack, 0.5))


def runs(inside: Mask) -> tuple[Index, Index]:
    """Starts and stops (exclusive) of the runs of true values in a mask (T,)."""
    edges = np.diff(np.concatenate(([0], inside.astype(np.int8), [0])))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def _resolution(t: Vec) -> float:
    """Resolution of increasing stamps [s], from their last decimal; 0 if they have full float precision."""
    least = float(np.diff(t).min())
    for digits in range(10):
        if 10.0**-digits > 1.001 * least:  # such coarse stamps would repeat
            continue
        scaled = t * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-4):
            return float(10.0**-digits)
    return 0.0


@dataclass(frozen=True)
class SuspectedUnit:
    """Suspected unit of time stamps that were read as seconds."""

    units: tuple[str, ...]  # the unit, or two equally likely ones, keys of `SECONDS`
    certain: bool  # whether the rate in seconds is impossible in this field

    @property
    def text(self) -> str:
        """Question to the user, and the key of a mapping file that corrects the unit."""
        names = " or ".join(UNIT_NAMES[unit] for unit in self.units)
        return f"is it in {names}? A mapping file with `time_unit: {self.units[0]}` reads it"


def suspected_unit(t: Vec, turns: int = 0) -> SuspectedUnit | None:
    """Suspected unit of stamps (T,) that were read as seconds; None if seconds are plausible.

    If the rate is too slow or too fast for seconds, the unit is chosen that makes the rate and the time between two
    reversals of the command most usual.

    Args:
        turns: reversals of the command; 0 if unknown.
    """
    interval = interval_of(t)
    if interval is None:
        return None
    step, duration = interval.middle, interval.middle * t.size
    turn = duration / (turns + 1) if turns else None
    dated = step < 1e-3 and _DATES[0] < float(np.nanmin(t)) and float(np.nanmax(t)) < _DATES[1]
    if dated or step <= 1 / UNUSUAL_HZ:
        return SuspectedUnit(_likeliest(("min", "h", "d"), step, turn, dated), dated or step <= 1 / FASTEST_HZ)
    if step >= 1 / SLOWEST_HZ:
        return SuspectedUnit(_likeliest(("ms", "us", "ns"), step, turn), certain=True)
    if step >= 0.1 / SLOWEST_HZ and turn is not None and turn > _NEVER_TURNS_S:
        return SuspectedUnit(("ms",), certain=False)
    return None


def _likeliest(units: tuple[str, ...], step: float, turn: float | None, dated: bool = False) -> tuple[str, ...]:
    if dated:
        return ("d",)

    def unusual(unit: str) -> float:
        one = SECONDS[unit]
        slow = abs(np.log10(_USUAL_HZ * step * one))
        return float(slow if turn is None else slow + abs(np.log10(turn * one / _USUAL_S)))

    first, second, *_ = sorted(units, key=unusual)
    return (first, second) if unusual(second) < unusual(first) + _IN_DOUBT else (first,)


@dataclass(frozen=True)
class CounterWrap:
    """Wrap of a clock: a counter that restarts at its least value."""

    modulus: float  # size of the fall, in the unit of the stamps
    bits: int  # of the counter; 0 if the modulus is not 2^n
    samples: tuple[int, ...]  # first samples after a fall

    @property
    def text(self) -> str:
        """Description of the wrap for messages."""
        if self.bits and self.modulus == 2.0**self.bits:
            return f"a counter of {self.bits} bits that wraps at 2^{self.bits}"
        return f"a clock that wraps at {self.modulus:.16g}"


_PERIODS = (1.0, 60.0, 3600.0, 43200.0, 86400.0)  # seconds of a minute, of an hour, of half a day, of a day
_SCALES = (1e9, 1e6, 1e3, 1.0)
# Modulus: bits of its counter, 0 of a clock.
_MODULI = {2.0**bits / scale: bits for bits in range(8, 65) for scale in _SCALES}
_MODULI |= {second * scale: 0 for second in _PERIODS for scale in _SCALES}


def counter_wrap(t: Vec) -> CounterWrap | None:
    """Detect the wraps of a counter in time stamps (T,) of any unit; None if there are none.

    Every fall has to be that of one counter: 2^n counts of s, ms, us or ns, or a minute, hour or day.
    """
    kept = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[kept])
    back, forward = np.flatnonzero(steps < 0), steps[steps > 0]
    if not back.size or not forward.size:
        return None
    interval = interval_of(t)
    usual = interval.middle if interval is not None else float(np.median(forward))
    falls = usual - steps[back]
    slack = max(2 * float(np.percentile(forward, 99)), usual)
    fall = float(np.median(falls))
    if fall < 4 * slack or np.any(np.abs(falls - fall) > slack):
        return None
    moduli = np.array(list(_MODULI))
    near = float(moduli[np.argmin(np.abs(moduli - fall))])
    if abs(near - fall) > min(slack, 0.2 * fall) or float(np.nanmax(t) - np.nanmin(t)) > near:
        return None
    return CounterWrap(near, _MODULI[near], tuple(int(kept[k + 1]) for k in back))


def without_wraps(t: Vec, modulus: float) -> Vec:
    """Unwrap time stamps (T,) of a counter: add the modulus at each fall by more than half of it."""
    falls = np.diff(t, prepend=t[:1]) < -0.5 * modulus
    return t + modulus * np.cumsum(falls)
