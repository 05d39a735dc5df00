"""Safe motions within command and rate limits: a fixed menu, and a family with 22 free numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import root_scalar

from hystmpc.ctrl.command import CommandLimits
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

LONGEST_S = 90.0  # unless a template needs more
REST_S = 1.0
RATE_SHARE = 0.9  # of the rate limit, for every motion
_NYQUIST_SHARE = 0.4  # a sine is sampled five times a period at least
_SINE_RATE_SHARE = 0.8  # leaves room for the rise and fall of a burst
_EDGE_S = 1.0
_LEAST_RAMP = 2  # samples of a ramp that turns at once


@dataclass(frozen=True)
class RampAndHold:
    """Ramp to a command, followed by a hold.

    Attributes:
        target: share of the reach, 0 at the lowest command.
        speed: share of the allowed rate.
        stroke_s: least time for the whole reach [s].
    """

    target: float
    hold_s: float
    speed: float = 0.5
    stroke_s: float = 0.0

    def way_s(self, start: float, reach: float, rate: float, least_s: float) -> float:
        """Duration of the ramp from a start, a share of the reach [s]; without a hold at least `least_s`."""
        way = abs(self.target - start) * max(reach / (self.speed * rate), self.stroke_s)
        return way if self.hold_s else max(way, least_s)


@dataclass(frozen=True)
class SineBurst:
    """Sum of small sines about the current command, faded in and out.

    Attributes:
        frequencies_hz: frequencies of the sines, all of one amplitude.
        amplitude: greatest amplitude of their sum, share of the reach; reduced to meet the rate limit.
        duration_s: including fade-in and fade-out [s].
    """

    frequencies_hz: tuple[float, ...]
    amplitude: float
    duration_s: float


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """One motion of the menu, sampled.

    Attributes:
        purpose: effects that it distinguishes, for the report.
        t: times [s], (T,), from 0 in steps of dt.
        command: command [mm or bar], (T,); starts and ends at rest at the lowest one.
    """

    name: str
    purpose: str
    t: Vec
    command: Vec

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1])


@dataclass(frozen=True)
class MotionTemplate:
    """Motion in shares of the reach and of the rate, independent of the limits."""

    name: str
    purpose: str
    parts: tuple[RampAndHold | SineBurst, ...]
    longest_s: float = LONGEST_S


def _strokes(
    peaks: Sequence[float], hold_s: float, speed: float = 0.5, stroke_s: float = 0.0
) -> tuple[RampAndHold, ...]:
    return tuple(RampAndHold(target, hold_s, speed, stroke_s) for peak in peaks for target in (peak, 0.0))


TEMPLATES = (
    MotionTemplate(
        "opening_repeat",
        "the same opening three times: a set taken once differs only in the first, creep and shifts in all",
        _strokes((1.0,) * 3, 4.0),
    ),
    MotionTemplate(
        "ramps_three_speeds",
        "the same way at three speeds, with holds: friction that jumps, lag and rate dependence change with speed",
        tuple(leg for speed in (1.0, 0.33, 0.1) for leg in _strokes((0.9,), 3.0, speed)),
    ),
    MotionTemplate(
        "long_holds",
        "45 s at one command, back, and the same move again: creep comes to rest and repeats, drift goes on",
        (RampAndHold(0.8, 45.0), RampAndHold(0.0, 10.0), RampAndHold(0.8, 12.0), RampAndHold(0.0, 3.0)),
    ),
    MotionTemplate(
        "fast_steps_small_sines",
        "steps at full speed, then small sines of 2 to 4 Hz: lag rounds and damps, delay only moves in time, "
        "rate dependence widens the loop",
        (
            *(RampAndHold(target, 1.5, 1.0) for target in (0.5, 0.25, 0.75, 0.4, 0.6, 0.5)),
            *(SineBurst((hz,), 0.08, 5.0) for hz in (2.0, 3.0, 4.0)),
            RampAndHold(0.0, 2.0),
        ),
    ),
    MotionTemplate(
        "dwell_near_lowest",
        "small moves near the lowest command: slack is dead there, a curved map is not",
        _strokes((0.06, 0.12, 0.2, 0.3, 0.06, 0.12), 1.5, 0.15),
    ),
    MotionTemplate(
        "top_from_amplitudes",
        "the top reached from several commands: a stop or saturation acts at one angle whatever the way there",
        tuple(RampAndHold(target, 1.0) for start in (0.75, 0.5, 0.25, 0.0) for target in (1.0, start)),
    ),
    MotionTemplate(
        "small_multi_sine",
        "small sines of four frequencies at once, away from both ends: dynamics apart from hysteresis",
        (RampAndHold(0.5, 2.0), SineBurst((0.4, 0.9, 1.7, 2.9), 0.1, 24.0), RampAndHold(0.0, 2.0)),
    ),
    MotionTemplate(
        "slow_strokes",
        "the whole range at a crawl, twice: a corner, a toe and a smooth curve differ, nothing that needs speed does",
        _strokes((1.0, 1.0), 1.0, 1.0, 12.0),
    ),
    MotionTemplate(
        "growing_strokes",
        "strokes that reach further each time, then less far: what a new greatest bend does, and what one angle does",
        _strokes((0.2, 0.4, 0.6, 0.8, 1.0, 0.5, 1.0), 1.0, 1.0, 5.0),
    ),
    MotionTemplate(
        "fast_strokes",
        "strokes at full speed that stop and turn: a lag goes on, friction that grows with speed lets go",
        tuple(
            RampAndHold(target, 0.0 if target == 0.2 else 1.5, 1.0)
            for peak in (0.4, 0.8, 0.6, 1.0)
            for target in (peak, 0.2, 0.7 * peak, 0.0)
        ),
    ),
    MotionTemplate(
        "fast_zigzags",
        "zigzags at full speed, ever smaller: a lag damps them, a delay moves them, rate dependence turns late",
        tuple(
            RampAndHold(target, 0.0, 1.0)
            for low, high in ((0.2, 0.8), (0.3, 0.6), (0.4, 0.55), (0.45, 0.5))
            for target in (low, *(high, low) * 6)
        )
        + (RampAndHold(0.0, 2.0),),
    ),
    MotionTemplate(
        "again_and_again",
        "one slow stroke for four minutes: a drift goes on, a shift between trials does not, creep comes to rest",
        _strokes((0.9,) * 12, 2.0, 1.0, 8.0),
        300.0,
    ),
)


def menu(limits: CommandLimits, dt: float) -> tuple[SampledMotion, ...]:
    """Motions of the menu on one device, within the limits [mm or bar, and per second], at a sample time [s].

    They use at most 0.9 of the rate limit, and a smaller reach if they would take more than 90 s.
    """
    return tuple(_motion(template, limits, dt) for template in TEMPLATES)


def _motion(template: MotionTemplate, limits: CommandLimits, dt: float) -> SampledMotion:
    rate, least_s = RATE_SHARE * limits.rate, _LEAST_RAMP * dt
    reach = _reach(template, limits, least_s)
    pieces, at, start = [(np.array([0.0, REST_S]), np.zeros(2))], 0.0, REST_S
    for part in template.parts:
        if isinstance(part, RampAndHold):
            way = part.way_s(at, reach, rate, least_s)
            piece = np.array([0.0, way, way + part.hold_s]), reach * np.array([at, part.target, part.target])
            at = part.target
        else:
            piece = sampled_burst(part, at * reach, reach, rate, dt)
        pieces.append((piece[0] + start, piece[1]))
        start = float(pieces[-1][0][-1])
    knots, values = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    t: Vec = np.arange(int(np.floor((start + REST_S) / dt)) + 1, dtype=np.float64) * dt
    command = limits.lower + np.interp(t, knots, values)
    return SampledMotion(template.name, template.purpose, t, np.clip(command, limits.lower, limits.upper))


def _reach(template: MotionTemplate, limits: CommandLimits, least_s: float) -> float:
    """Greatest command above the lowest at which the motion stays within its longest duration."""
    rate, whole = RATE_SHARE * limits.rate, limits.upper - limits.lower

    def excess_s(reach: float) -> float:
        return _duration_s(template, reach, rate, least_s) - template.longest_s

    return whole if excess_s(whole) <= 0 else float(root_scalar(excess_s, bracket=(0.0, whole)).root)


def _duration_s(template: MotionTemplate, reach: float, rate: float, least_s: float) -> float:
    at, seconds = 0.0, 2 * REST_S
    for part in template.parts:
        if isinstance(part, RampAndHold):
            seconds, at = seconds + part.way_s(at, reach, rate, least_s) + part.hold_s, part.target
        else:
            seconds += part.duration_s
    return seconds


def sampled_burst(part: SineBurst, centre: float, reach: float, rate: float, dt: float) -> tuple[Vec, Vec]:
    """Times and commands of a burst, on a separate grid with linear interpolation.

    Slopes of A w(t) sum_i sin(2 pi f_i t) / n are at most A (2 pi mean f + 1 / edge), w rising within the edge.
    """
    frequencies = np.minimum(part.frequencies_hz, _NYQUIST_SHARE / (2 * dt))
    steepest = 2 * np.pi * float(np.mean(frequencies)) + 1 / _EDGE_S
    amplitude = min(part.amplitude * reach, _SINE_RATE_SHARE * rate / steepest)
    t = np.linspace(0.0, part.duration_s, int(np.ceil(part.duration_s / dt)) + 1)
    window = np.clip(np.minimum(t, part.duration_s - t) / _EDGE_S, 0.0, 1.0)
    waves = np.sin(2 * np.pi * frequencies[:, None] * t).mean(axis=0)
    return t, centre + amplitude * window * waves


LEGS = 6
"""Number of ramps of a motion, each with a hold."""

SIZE = 3 * LEGS + 4
"""Number of parameters of a motion, each between 0 and 1."""

_BURST_AFTER = 3  # legs
_SLOWEST, _HOLD_S = 0.03, (0.05, 20.0)  # of the allowed rate; shortest and longest hold, logarithmic
_BURST_S, _HZ, _RATIO, _SINE = (0.3, 10.0), (0.3, 4.0), (1.0, 3.0), 0.25  # duration, frequency, second one, amplitude
_NO_BURST_S = 1.0  # a shorter burst is left out


@dataclass(frozen=True)
class MotionFamily:
    """Parametrised family of motions: rest, three ramps with holds, two sines, three ramps with holds, return, rest.

    A motion is given by numbers x (22,) in [0, 1]: of each ramp the target (share of the range, counted from the end
    nearer to the safe command), the speed (3 to 100 % of the allowed rate, logarithmic) and the hold (0.05 to 20 s,
    logarithmic); of the burst the amplitude, the frequency, the ratio of the second frequency, and the duration. A
    motion that would last too long is played faster and, if necessary, with less reach.

    Attributes:
        limits: box and rate of the command [mm or bar, and per second].
        longest_s: greatest duration of a motion [s].

    Raises:
        TrajectoryError: if the sample time or the duration is not positive, or the safe command lies outside.
    """

    limits: CommandLimits
    dt: float
    safe: float
    longest_s: float

    def __post_init__(self) -> None:
        times = math.isfinite(self.dt) and self.dt > 0 and self.longest_s >= 4 * REST_S
        if not (times and self.limits.lower <= self.safe <= self.limits.upper):
            raise TrajectoryError(
                f"motion family: got dt {self.dt} s, at most {self.longest_s} s, safe command {self.safe}, expected "
                f"dt > 0, at least {4 * REST_S:g} s, a command within {self.limits}"
            )

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Ends of the range, the one nearer to the safe command first."""
        low, high = self.limits.lower, self.limits.upper
        return (low, high) if self.safe - low <= high - self.safe else (high, low)

    def motion(self, x: Vec, name: str, purpose: str = "") -> SampledMotion:
        """Sampled motion of numbers x (22,)."""
        numbers = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        legs, burst = numbers[: 3 * LEGS].reshape(LEGS, 3), numbers[3 * LEGS :]
        near, far = self._ends
        stops = near + legs[:, 0] * (far - near)
        rate = RATE_SHARE * self.limits.rate
        sine_s = _between(_BURST_S, burst[3])
        sine_s = sine_s if sine_s >= _NO_BURST_S else 0.0
        holds = np.array([_between(_HOLD_S, h) for h in legs[:, 2]])
        speeds = rate * np.array([_between((_SLOWEST, 1.0), v) for v in legs[:, 1]])
        room = self.longest_s - 2 * REST_S - 2 * self.dt
        stops, ways, holds, sine_s = _shortened(self.safe, stops, speeds, holds, sine_s, rate, room)
        pieces, at, start = [(np.array([0.0, REST_S]), np.array([self.safe, self.safe]))], self.safe, REST_S
        for k in range(LEGS):
            pieces.append((start + np.array([0.0, ways[k], ways[k] + holds[k]]), np.array([at, stops[k], stops[k]])))
            at, start = float(stops[k]), start + float(ways[k] + holds[k])
            if k + 1 == _BURST_AFTER and sine_s:
                hz = _between(_HZ, burst[1])
                part = SineBurst((hz, hz * _between(_RATIO, burst[2])), _SINE * float(burst[0]), sine_s)
                t, u = sampled_burst(part, at, abs(far - near), rate, self.dt)
                pieces.append((start + t, u))
                start += sine_s
        back = abs(self.safe - at) / rate
        pieces.append((start + np.array([0.0, back, back + REST_S]), np.array([at, self.safe, self.safe])))
        knots, values = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
        samples = int(np.floor(knots[-1] / self.dt)) + 1
        t = np.arange(samples, dtype=np.float64) * self.dt
        asked = np.clip(np.interp(t, knots, values), self.limits.lower, self.limits.upper)
        command = np.append(asked, self.safe)
        return SampledMotion(name, purpose, self.dt * np.arange(samples + 1, dtype=np.float64), command)

    @cached_property
    def starts(self) -> dict[str, Vec]:
        """Numbers (22,) of the motions of the menu, from the first six ramps and the first burst of each."""
        return {template.name: self._numbers_of(template) for template in TEMPLATES}

    def slower(self, x: Vec, factor: float) -> Vec:
        """Numbers (22,) of the same motion with all ramps slower by a factor below one, at 3 % of the rate at least."""
        legs = x[: 3 * LEGS].reshape(LEGS, 3).copy()
        legs[:, 1] = np.maximum(legs[:, 1] + math.log(factor) / math.log(1 / _SLOWEST), 0.0)
        return np.concatenate([legs.ravel(), x[3 * LEGS :]])

    def _numbers_of(self, template: MotionTemplate) -> Vec:
        bursts = [part for part in template.parts if isinstance(part, SineBurst)]
        at = template.parts.index(bursts[0]) if bursts else len(template.parts)
        before = [part for part in template.parts[:at] if isinstance(part, RampAndHold)]
        after = [part for part in template.parts[at:] if isinstance(part, RampAndHold)][:_BURST_AFTER]
        rest = RampAndHold(0.0, _HOLD_S[0], 1.0)
        if bursts:
            before = ([rest] * _BURST_AFTER + before)[-_BURST_AFTER:]
        legs = [*before, *after][:LEGS]
        rate, reach = RATE_SHARE * self.limits.rate, self.limits.upper - self.limits.lower
        rows = []
        for leg in legs + [rest] * (LEGS - len(legs)):
            speed = min(leg.speed, reach / (rate * leg.stroke_s)) if leg.stroke_s else leg.speed
            rows += [leg.target, _share((_SLOWEST, 1.0), speed), _share(_HOLD_S, max(leg.hold_s, _HOLD_S[0]))]
        if not bursts:
            return np.array([*rows, 0.3, 0.5, 0.5, 0.0])
        hz, most = bursts[0].frequencies_hz, max(bursts[-1].frequencies_hz[-1], bursts[0].frequencies_hz[0])
        tail = (_share(_HZ, hz[0]), _share(_RATIO, most / hz[0]), _share(_BURST_S, bursts[0].duration_s))
        return np.clip(np.array([*rows, bursts[0].amplitude / _SINE, *tail]), 0.0, 1.0)


def _shortened(
    safe: float, stops: Vec, speeds: Vec, holds: Vec, sine_s: float, rate: float, room: float
) -> tuple[Vec, Vec, Vec, float]:
    """Stops, durations of ramps and holds (LEGS,) [s], and of the burst [s], that together take at most `room`."""

    def least(s: Vec) -> tuple[Vec, float]:
        ways = np.abs(np.diff(s, prepend=safe)) / rate
        return ways, float(ways.sum()) + abs(safe - float(s[-1])) / rate

    quickest, needed = least(stops)
    if needed > 0.9 * room:
        stops = safe + 0.9 * room / needed * (stops - safe)
        quickest, needed = least(stops)
    ways = np.maximum(np.abs(np.diff(stops, prepend=safe)) / speeds, quickest)
    more = float((ways - quickest).sum() + holds.sum()) + sine_s
    share = min(1.0, (room - needed) / more) if more > 0 else 1.0
    return stops, quickest + share * (ways - quickest), share * holds, share * sine_s


def _between(ends: tuple[float, float], share: float) -> float:
    return float(ends[0] * (ends[1] / ends[0]) ** share)


def _share(ends: tuple[float, float], value: float) -> float:
    return float(np.clip(math.log(value / ends[0]) / math.log(ends[1] / ends[0]), 0.0, 1.0))
