"""Menu of safe motions that a diagnosis may ask for; all within command and rate limits by construction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Leg:
    """A ramp to a command and a hold there.

    Attributes:
        target: share of the reach, 0 at the lowest command.
        hold_s: time at the target [s].
        speed: share of the allowed rate.
        stroke_s: time that the whole reach takes at least [s].
    """

    target: float
    hold_s: float
    speed: float = 0.5
    stroke_s: float = 0.0

    def way_s(self, start: float, reach: float, rate: float) -> float:
        """Time from another command to its own, both in shares of the reach [s]."""
        return abs(self.target - start) * max(reach / (self.speed * rate), self.stroke_s)


@dataclass(frozen=True)
class SineBurst:
    """A sum of small sines about the command reached, faded in and out.

    Attributes:
        frequencies_hz: one sine each, all of one amplitude.
        amplitude: of their sum at most, share of the reach; less where the rate limit asks for it.
        duration_s: with its rise and fall [s].
    """

    frequencies_hz: tuple[float, ...]
    amplitude: float
    duration_s: float


@dataclass(frozen=True, eq=False)
class MenuMotion:
    """One motion of the menu, sampled.

    Attributes:
        name: of the motion.
        purpose: what it tells apart, for the report.
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
    """A motion before limits are known: parts in shares of the reach and of the rate.

    Attributes:
        name, purpose: see `MenuMotion`.
        parts: in order.
        longest_s: duration that the reach is cut to [s].
    """

    name: str
    purpose: str
    parts: tuple[Leg | SineBurst, ...]
    longest_s: float = LONGEST_S


def _strokes(peaks: Sequence[float], hold_s: float, speed: float = 0.5, stroke_s: float = 0.0) -> tuple[Leg, ...]:
    """To each peak and back to the lowest command."""
    return tuple(Leg(target, hold_s, speed, stroke_s) for peak in peaks for target in (peak, 0.0))


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
        (Leg(0.8, 45.0), Leg(0.0, 10.0), Leg(0.8, 12.0), Leg(0.0, 3.0)),
    ),
    MotionTemplate(
        "fast_steps_small_sines",
        "steps at full speed, then small sines of 2 to 4 Hz: lag rounds and damps, delay only moves in time, "
        "rate dependence widens the loop",
        (
            *(Leg(target, 1.5, 1.0) for target in (0.5, 0.25, 0.75, 0.4, 0.6, 0.5)),
            *(SineBurst((hz,), 0.08, 5.0) for hz in (2.0, 3.0, 4.0)),
            Leg(0.0, 2.0),
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
        tuple(Leg(target, 1.0) for start in (0.75, 0.5, 0.25, 0.0) for target in (1.0, start)),
    ),
    MotionTemplate(
        "small_multi_sine",
        "small sines of four frequencies at once, away from both ends: dynamics apart from hysteresis",
        (Leg(0.5, 2.0), SineBurst((0.4, 0.9, 1.7, 2.9), 0.1, 24.0), Leg(0.0, 2.0)),
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
            Leg(target, 0.0 if target == 0.2 else 1.5, 1.0)
            for peak in (0.4, 0.8, 0.6, 1.0)
            for target in (peak, 0.2, 0.7 * peak, 0.0)
        ),
    ),
    MotionTemplate(
        "again_and_again",
        "one slow stroke for four minutes: a drift goes on, a shift between trials does not, creep comes to rest",
        _strokes((0.9,) * 12, 2.0, 1.0, 8.0),
        300.0,
    ),
)


def menu(limits: CommandLimits, dt: float) -> tuple[MenuMotion, ...]:
    """Every motion of the menu on one device.

    All lie within the limits and change by at most 0.9 of the rate limit. The reach of a motion shrinks where it would
    take more than 90 s otherwise.

    Args:
        limits: box and rate of the command [mm or bar, and per second].
        dt: sample time [s].

    Raises:
        TrajectoryError: if dt is not finite and positive.
    """
    if not (math.isfinite(dt) and dt > 0):
        raise TrajectoryError(f"dt: got {dt}, expected a finite number > 0")
    return tuple(_motion(template, limits, dt) for template in TEMPLATES)


def _motion(template: MotionTemplate, limits: CommandLimits, dt: float) -> MenuMotion:
    rate, reach = RATE_SHARE * limits.rate, _reach(template, limits)
    pieces, at, start = [(np.array([0.0, REST_S]), np.zeros(2))], 0.0, REST_S
    for part in template.parts:
        if isinstance(part, Leg):
            way = part.way_s(at, reach, rate)
            piece = np.array([0.0, way, way + part.hold_s]), reach * np.array([at, part.target, part.target])
            at = part.target
        else:
            piece = sampled_burst(part, at * reach, reach, rate, dt)
        pieces.append((piece[0] + start, piece[1]))
        start = float(pieces[-1][0][-1])
    knots, values = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    t: Vec = np.arange(int(np.floor((start + REST_S) / dt)) + 1, dtype=np.float64) * dt
    command = limits.lower + np.interp(t, knots, values)
    return MenuMotion(template.name, template.purpose, t, np.clip(command, limits.lower, limits.upper))


def _reach(template: MotionTemplate, limits: CommandLimits) -> float:
    """Greatest command above the lowest with which the motion keeps within its longest duration."""
    rate, whole = RATE_SHARE * limits.rate, limits.upper - limits.lower
    if _duration_s(template, whole, rate) <= template.longest_s:
        return whole
    found = root_scalar(lambda reach: _duration_s(template, reach, rate) - template.longest_s, bracket=(0.0, whole))
    return float(found.root)


def _duration_s(template: MotionTemplate, reach: float, rate: float) -> float:
    """Duration at a reach [s]."""
    at, seconds = 0.0, 2 * REST_S
    for part in template.parts:
        if isinstance(part, Leg):
            seconds, at = seconds + part.way_s(at, reach, rate) + part.hold_s, part.target
        else:
            seconds += part.duration_s
    return seconds


def sampled_burst(part: SineBurst, centre: float, reach: float, rate: float, dt: float) -> tuple[Vec, Vec]:
    """Times and commands of a burst, on a grid of its own with linear interpolation.

    Slopes of A w(t) sum_i sin(2 pi f_i t) / n are at most A (2 pi mean f + 1 / edge), w rising within the edge.
    """
    frequencies = np.minimum(part.frequencies_hz, _NYQUIST_SHARE / (2 * dt))
    steepest = 2 * np.pi * float(np.mean(frequencies)) + 1 / _EDGE_S
    amplitude = min(part.amplitude * reach, _SINE_RATE_SHARE * rate / steepest)
    t = np.linspace(0.0, part.duration_s, int(np.ceil(part.duration_s / dt)) + 1)
    window = np.clip(np.minimum(t, part.duration_s - t) / _EDGE_S, 0.0, 1.0)
    waves = np.sin(2 * np.pi * frequencies[:, None] * t).mean(axis=0)
    return t, centre + amplitude * window * waves
