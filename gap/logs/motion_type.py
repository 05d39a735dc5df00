"""Motion types (sine, steps, holds, ...) and features of the command history of a trial, from its command alone."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.hysteresis import Play
from hystmpc.trials.segments import Motion, SegmentRule, Segments, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Mat, Vec, lagged

from .sensor import white_noise

MotionType = Literal["sine", "sines", "holds", "steps", "ramps", "point_to_point", "scan", "mixed"]

STEP_S = 0.2  # longest move that counts as a step, faster than any hand or joystick
_HELD_SHARE = 0.2  # of the time at rest, below which the motion is continuous
_HOLDS_SHARE, _HOLDS_S = 0.6, 3.0
_SHAPE_POINTS = np.linspace(0.0, 1.0, 33)
_HALF_COSINE = 0.5 - 0.5 * np.cos(np.pi * _SHAPE_POINTS)
_LINE = 0.05  # of the height of a move, root mean square: a line and a half cosine are 0.07 apart
_COSINE = 0.2  # of the height: a half cosine after an actuator with lag and friction
_SMALL = 0.05  # of the range, below which moves are ignored for the shape
_REGULAR = 0.1  # spread of the times between turns, relative to their mean
_NOISE_BAND = 6.0  # standard deviations of the command's own noise


@dataclass(frozen=True)
class Move:
    """Part of a trial in which the command rises or falls.

    Attributes:
        start, stop: samples, stop exclusive; the sample before `start` is its origin.
        first, last: levels at its ends [cmd].
        miss_line, miss_cosine: root mean square distance of its path from a line and from a half cosine, relative to
            its height; infinite for fewer than five samples.
    """

    start: int
    stop: int
    first: float
    last: float
    miss_line: float = math.inf
    miss_cosine: float = math.inf

    @property
    def samples(self) -> int:
        """Duration in sample intervals."""
        return self.stop - self.start

    @property
    def straight(self) -> bool:
        """Whether the speed is constant."""
        return self.miss_line < min(_LINE, self.miss_cosine)

    @property
    def height(self) -> float:
        """Absolute change of the command [cmd]."""
        return abs(self.last - self.first)


def command_segments(trial: Trial) -> Segments:
    """Segments of a uniform trial; the bands widen with the noise of a measured command."""
    span = float(np.ptp(trial.command))
    noise = white_noise([trial.command]) / span if span > 0 else 0.0
    band = float(np.clip(_NOISE_BAND * noise, SegmentRule.hold_band, 0.02))
    return segment(trial, SegmentRule(reversal=max(SegmentRule.reversal, 2 * band), hold_band=band))


def moves_of(trial: Trial, parts: Segments) -> list[Move]:
    """Moves of a trial in order of time."""
    runs = sorted(parts.runs(Motion.LOADING) + parts.runs(Motion.UNLOADING))
    return [_move(trial.command, start, stop) for start, stop in runs]


def _move(command: Vec, start: int, stop: int) -> Move:
    before = max(start - 1, 0)
    first, last = float(command[before]), float(command[stop - 1])
    path = command[before:stop]
    if path.size < 5 or first == last:
        return Move(start, stop, first, last)
    progress = (np.interp(_SHAPE_POINTS * (path.size - 1), np.arange(path.size), path) - first) / (last - first)
    misses = [float(np.sqrt(np.mean((progress - shape) ** 2))) for shape in (_SHAPE_POINTS, _HALF_COSINE)]
    return Move(start, stop, first, last, *misses)


def motion_type(trial: Trial, parts: Segments) -> MotionType:
    """Kind of motion of a uniform trial.

    With a fifth of the time at rest or more, after the initial rest: `steps` if the moves between rests take 0.2 s or
    less, `holds` if it rests most of the time and for 3 s or more each, otherwise `point_to_point`. With less rest the
    shape between turns counts: lines at one pace are a `scan`, otherwise `ramps`; half cosines, or nearly, at one pace
    are a `sine`, whose amplitude may decay; other curves are `sines`. All other motions are `mixed`.
    """
    holds = parts.holds
    lead = holds[0][1] if holds and holds[0][0] == 0 else 0
    rests = [(a, b) for a, b in holds if a >= lead]
    moves = [move for move in moves_of(trial, parts) if move.start >= lead]
    if not moves:
        return "holds"
    held = sum(b - a for a, b in rests) / (len(trial) - lead)
    journeys = _between_rests(moves, rests)
    turning = sum(_time(j) for j in journeys if len(j) > 2)
    moving = sum(_time(j) for j in journeys)
    if held < _HELD_SHARE or turning > 0.7 * moving:
        return _continuous(max(journeys, key=_time) if held >= _HELD_SHARE else moves, float(np.ptp(trial.command)))
    if turning > 0.3 * moving:
        return "mixed"
    if np.median([_time(journey) for journey in journeys]) * trial.dt <= STEP_S:
        return "steps"
    long = float(np.median([b - a for a, b in rests])) * trial.dt >= _HOLDS_S
    return "holds" if long and held >= _HOLDS_SHARE else "point_to_point"


def _time(journey: list[Move]) -> int:
    return sum(move.samples for move in journey)


def _between_rests(moves: list[Move], rests: list[tuple[int, int]]) -> list[list[Move]]:
    starts = [a for a, _ in rests]
    places = np.searchsorted(starts, [move.start for move in moves])
    return [[move for move, at in zip(moves, places, strict=True) if at == k] for k in sorted(set(places.tolist()))]


def _continuous(moves: list[Move], span: float) -> MotionType:
    large = [move for move in moves if move.height > _SMALL * span]
    if not large:
        return "mixed"
    total = _time(large)
    lines = _time([move for move in large if move.straight]) / total
    cosine = sum(m.samples * min(m.miss_cosine, 1.0) for m in large) / total
    regular = _regular(large)
    if lines >= 0.7:
        return "scan" if regular and len(large) >= 4 else "ramps"
    if regular and cosine < _COSINE and _monotonic([move.height for move in large[1:]], _SMALL * span):
        return "sine"
    return "sines" if lines <= 0.3 else "mixed"


def _regular(moves: list[Move]) -> bool:
    """Whether moves in one direction have equal duration; the first may be longer."""
    middles = np.array([0.5 * (move.start + move.stop) for move in moves[1 if len(moves) > 3 else 0 :]])
    periods = middles[2:] - middles[:-2]
    return periods.size < 2 or float(np.std(periods)) <= _REGULAR * float(np.mean(periods)) + 0.5


def _monotonic(heights: list[float], slack: float) -> bool:
    """Whether heights only decrease or only increase, apart from `slack`."""
    steps = np.diff(heights)
    return bool(np.all(steps <= slack) or np.all(steps >= -slack))


MEMORIES = ("speed", "since_reversal", "hold_age", "travel", "clock")

_AGES_S = (0.1, 0.4, 1.5, 6.0, 25.0)
_LAGS_S = (0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
_WIDTHS = (0.02, 0.05, 0.1, 0.18, 0.3, 0.45)  # of the command's range
_TYPICAL_SPEED = 0.3  # of the command in ranges [1/s]


def past_features(trials: Sequence[Trial]) -> list[Mat]:
    """Command, speeds, lagged and low-passed commands and plays (T, F) of each trial, of unit variance over all."""
    low = min(float(trial.command.min()) for trial in trials)
    span = max(float(trial.command.max()) for trial in trials) - low or 1.0
    rows = [_features_of_past((trial.command - low) / span, trial.dt) for trial in trials]
    samples = sum(len(x) for x in rows)
    mean = np.sum([x.sum(axis=0) for x in rows], axis=0) / samples
    variance = np.sum([((x - mean) ** 2).sum(axis=0) for x in rows], axis=0) / samples
    scale = np.maximum(np.sqrt(variance), 1e-9)
    return [(x - mean) / scale for x in rows]


def memory_features(trial: Trial, loop_width: float, clock_s: float) -> dict[str, Mat]:
    """Features (T, F) of a command for each of `MEMORIES`, given loop width [cmd] and time before the trial [s]."""
    parts, u, dt = command_segments(trial), trial.command, trial.dt
    span, width = max(float(np.ptp(u)), 1e-9), max(loop_width, 1e-9)
    v = np.gradient(u, dt) / span
    bounded = v / (np.abs(v) + _TYPICAL_SPEED)  # a step must not dominate the fit
    direction, held = _last_direction(parts), parts.labels == Motion.HOLD
    samples, travel, total = since_reversal(u, parts)
    t = np.arange(u.size, dtype=np.float64) * dt
    columns = (
        [bounded, np.abs(bounded), np.sign(v) * (np.abs(v) > 1e-3), bounded**2],
        _decaying(samples, dt, direction),
        _decaying(_samples_since(~held), dt, direction * held),
        [*(direction * np.exp(-travel / (k * width)) for k in (0.5, 1.0, 2.0)), total / span / 10.0],
        [t / 60.0, (clock_s + t) / 60.0],
    )
    return {name: np.column_stack(group) for name, group in zip(MEMORIES, columns, strict=True)}


def since_reversal(command: Vec, parts: Segments) -> tuple[Index, Vec, Vec]:
    """Samples and travel [cmd] since the last reversal, or since the start, and travel since the start (T,) each."""
    turned = np.zeros(command.size, dtype=np.bool_)
    turned[parts.reversals] = True
    samples = _samples_since(turned)
    travelled = np.cumsum(np.abs(np.diff(command, prepend=command[0])))
    return samples, travelled - travelled[np.arange(command.size) - samples], travelled


def _features_of_past(u: Vec, dt: float) -> Mat:
    """Features (T, F) of a command between 0 and 1 and its past."""
    lags = [max(1, round(lag / dt)) for lag in _LAGS_S]
    late = [np.concatenate([np.full(min(k, u.size), u[0]), u[:-k]])[: u.size] for k in lags]
    v = np.gradient(u, dt)
    slow = [lagged(u, tau / (tau + dt)) for tau in _AGES_S]
    return np.column_stack(
        [u, u**2, u**3, v, np.abs(v), np.sign(v), *late, *slow, *play_states(u, 0.5 * np.array(_WIDTHS)).T]
    )


def play_states(u: Vec, half: Vec, side: float = 0.0) -> Mat:
    """States (T, R) of plays of half-widths r (R,): p = max(u - r, min(u + r, p)), from u + `side` r on."""
    commands, begin = np.repeat(u[:, None], half.size, axis=1), (u[0] + side * half)[None]
    return _play().simulate(commands, 1.0, begin, half[None])[0]


@functools.cache
def _play() -> StagedChain:
    return StagedChain(Chain(Play(0.0)))


def _decaying(age: Index, dt: float, weight: Vec) -> list[Vec]:
    """Weight (T,), and its products with exponentials of an age in samples (T,)."""
    return [weight, *(weight * np.exp(-(age * dt) / tau) for tau in _AGES_S)]


def _last_direction(parts: Segments) -> Vec:
    """Direction (+1 or -1) of the last move up to each sample (T,); 0 before the first."""
    last = np.maximum.accumulate(np.where(parts.labels != Motion.HOLD, np.arange(parts.labels.size), -1))
    return np.where(last >= 0, parts.labels[last], 0).astype(np.float64)


def _samples_since(events: Mask) -> Index:
    k = np.arange(events.size)
    return k - np.maximum.accumulate(np.where(events, k, 0))
