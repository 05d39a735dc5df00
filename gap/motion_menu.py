"""The menu of safe motions that a diagnosis may ask for: within command and rate limits by construction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root_scalar

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trajectories.trajectory import require_positive
from hystmpc.trials.types import Vec

LONGEST_S = 90.0  # but where a plan needs more
REST_S = 1.0
RATE_SHARE = 0.9  # of the rate limit: what every motion stays below
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
class Burst:
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
class Motion:
    """One motion of the menu, sampled.

    Attributes:
        name: what it is called.
        purpose: what it tells apart, in words.
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
class Plan:
    """A motion before limits are known: parts in shares of the reach and of the rate.

    Attributes:
        name, purpose: see `Motion`.
        parts: in order.
        longest_s: duration that the reach is cut to [s].
    """

    name: str
    purpose: str
    parts: tuple[Leg | Burst, ...]
    longest_s: float = LONGEST_S


def _opening() -> tuple[Leg, ...]:
    return (Leg(1.0, 4.0), Leg(0.0, 4.0)) * 3


def _three_speeds() -> Iterator[Leg]:
    for speed in (1.0, 0.33, 0.1):
        yield from (Leg(0.9, 3.0, speed), Leg(0.0, 3.0, speed))


def _steps() -> tuple[Leg, ...]:
    return tuple(Leg(target, 1.5, 1.0) for target in (0.5, 0.25, 0.75, 0.4, 0.6, 0.5))


def _dwell() -> Iterator[Leg]:
    for peak in (0.06, 0.12, 0.2, 0.3, 0.06, 0.12):
        yield from (Leg(peak, 1.5, 0.15), Leg(0.0, 1.5, 0.15))


def _tops() -> Iterator[Leg]:
    for start in (0.75, 0.5, 0.25, 0.0):
        yield from (Leg(1.0, 1.0), Leg(start, 1.0))


def _slow() -> tuple[Leg, ...]:
    return (Leg(1.0, 1.0, 1.0, 12.0), Leg(0.0, 1.0, 1.0, 12.0)) * 2


def _growing() -> Iterator[Leg]:
    for peak in (0.2, 0.4, 0.6, 0.8, 1.0, 0.5, 1.0):
        yield from (Leg(peak, 1.0, 1.0, 5.0), Leg(0.0, 1.0, 1.0, 5.0))


def _fast() -> Iterator[Leg]:
    for peak in (0.4, 0.8, 0.6, 1.0):
        yield from (Leg(peak, 1.5, 1.0), Leg(0.2, 0.0, 1.0), Leg(0.7 * peak, 1.5, 1.0), Leg(0.0, 1.5, 1.0))


def _again_and_again() -> tuple[Leg, ...]:
    return (Leg(0.9, 2.0, 1.0, 8.0), Leg(0.0, 2.0, 1.0, 8.0)) * 12


PLANS = (
    Plan(
        "opening_repeat",
        "the same opening three times: a set taken once differs only in the first, creep and shifts in all",
        _opening(),
    ),
    Plan(
        "ramps_three_speeds",
        "the same way at three speeds, with holds: friction that jumps, lag and rate dependence change with speed",
        tuple(_three_speeds()),
    ),
    Plan(
        "long_holds",
        "45 s at one command, back, and the same move again: creep comes to rest and repeats, drift goes on",
        (Leg(0.8, 45.0), Leg(0.0, 10.0), Leg(0.8, 12.0), Leg(0.0, 3.0)),
    ),
    Plan(
        "fast_steps_small_sines",
        "steps at full speed, then small sines of 2 to 4 Hz: lag rounds and damps, delay only moves in time, "
        "rate dependence widens the loop",
        (*_steps(), Burst((2.0,), 0.08, 5.0), Burst((3.0,), 0.08, 5.0), Burst((4.0,), 0.08, 5.0), Leg(0.0, 2.0)),
    ),
    Plan(
        "dwell_near_lowest",
        "small moves near the lowest command: slack is dead there, a curved map is not",
        tuple(_dwell()),
    ),
    Plan(
        "top_from_amplitudes",
        "the top reached from several commands: a stop or saturation acts at one angle whatever the way there",
        tuple(_tops()),
    ),
    Plan(
        "small_multi_sine",
        "small sines of four frequencies at once, away from both ends: dynamics apart from hysteresis",
        (Leg(0.5, 2.0), Burst((0.4, 0.9, 1.7, 2.9), 0.1, 24.0), Leg(0.0, 2.0)),
    ),
    Plan(
        "slow_strokes",
        "the whole range at a crawl, twice: a corner, a toe and a smooth curve differ, nothing that needs speed does",
        _slow(),
    ),
    Plan(
        "growing_strokes",
        "strokes that reach further each time, then less far: what a new greatest bend does, and what one angle does",
        tuple(_growing()),
    ),
    Plan(
        "fast_strokes",
        "strokes at full speed that stop and turn: a lag goes on, friction that grows with speed lets go",
        tuple(_fast()),
    ),
    Plan(
        "again_and_again",
        "one slow stroke for four minutes: a drift goes on, a shift between trials does not, creep comes to rest",
        _again_and_again(),
        300.0,
    ),
)


def menu(limits: CommandLimits, dt: float) -> tuple[Motion, ...]:
    """Every motion of the menu on one device.

    All lie within the limits and change by at most 0.9 of the rate limit; the reach of a motion shrinks where its
    travel would not fit into 90 s otherwise.

    Args:
        limits: box and rate of the command [mm or bar, and per second].
        dt: sample time [s].

    Raises:
        TrajectoryError: if dt is not finite and positive.
    """
    require_positive(dt=dt)
    return tuple(_motion(plan, limits, dt) for plan in PLANS)


def _motion(plan: Plan, limits: CommandLimits, dt: float) -> Motion:
    rate, reach = RATE_SHARE * limits.rate, _reach(plan, limits)
    pieces, at, start = [(np.array([0.0, REST_S]), np.zeros(2))], 0.0, REST_S
    for part in plan.parts:
        if isinstance(part, Leg):
            way = part.way_s(at, reach, rate)
            piece = np.array([0.0, way, way + part.hold_s]), reach * np.array([at, part.target, part.target])
            at = part.target
        else:
            piece = _burst(part, at * reach, reach, rate, dt)
        pieces.append((piece[0] + start, piece[1]))
        start = float(pieces[-1][0][-1])
    knots, values = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    t: Vec = np.arange(int(np.floor((start + REST_S) / dt)) + 1, dtype=np.float64) * dt
    command = limits.lower + np.interp(t, knots, values)
    return Motion(plan.name, plan.purpose, t, np.clip(command, limits.lower, limits.upper))


def _reach(plan: Plan, limits: CommandLimits) -> float:
    """Greatest command above the lowest that the motion can go to and back within its longest duration."""
    rate, whole = RATE_SHARE * limits.rate, limits.upper - limits.lower
    if _lasts(plan, whole, rate) <= plan.longest_s:
        return whole
    found = root_scalar(lambda reach: _lasts(plan, reach, rate) - plan.longest_s, bracket=(0.0, whole))
    return float(found.root)


def _lasts(plan: Plan, reach: float, rate: float) -> float:
    """Duration of a plan at a reach [s]."""
    at, seconds = 0.0, 2 * REST_S
    for part in plan.parts:
        if isinstance(part, Leg):
            seconds, at = seconds + part.way_s(at, reach, rate) + part.hold_s, part.target
        else:
            seconds += part.duration_s
    return seconds


def _burst(part: Burst, centre: float, reach: float, rate: float, dt: float) -> tuple[Vec, Vec]:
    """Times and commands of a burst, on its own grid: between samples a command runs straight.

    Slopes of A w(t) sum_i sin(2 pi f_i t) / n are at most A (2 pi mean f + 1 / edge), w rising within the edge.
    """
    frequencies = np.minimum(part.frequencies_hz, _NYQUIST_SHARE / (2 * dt))
    steepest = 2 * np.pi * float(np.mean(frequencies)) + 1 / _EDGE_S
    amplitude = min(part.amplitude * reach, _SINE_RATE_SHARE * rate / steepest)
    t = np.linspace(0.0, part.duration_s, int(np.ceil(part.duration_s / dt)) + 1)
    window = np.clip(np.minimum(t, part.duration_s - t) / _EDGE_S, 0.0, 1.0)
    waves = np.sin(2 * np.pi * frequencies[:, None] * t).mean(axis=0)
    return t, centre + amplitude * window * waves
