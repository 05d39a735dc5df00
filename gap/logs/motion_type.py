"""Motion type of a trial, from its command alone: sine, steps, holds, ramps, scan, ..."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hystmpc.trials.segments import Motion, SegmentRule, Segments, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .white_noise import white_noise

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
    """A stretch in which the command rises or falls.

    Attributes:
        start, stop: samples, stop exclusive; the sample before `start` is where it came from.
        first, last: levels at its ends [cmd].
        miss_line, miss_cosine: root mean square distance of its path from a line and from a half cosine, relative to
            its height; infinite where it has fewer than five samples.
    """

    start: int
    stop: int
    first: float
    last: float
    miss_line: float = math.inf
    miss_cosine: float = math.inf

    @property
    def samples(self) -> int:
        """Sample intervals that it takes."""
        return self.stop - self.start

    @property
    def straight(self) -> bool:
        """Whether the speed is constant."""
        return self.miss_line < min(_LINE, self.miss_cosine)

    @property
    def height(self) -> float:
        """Change of the command, without sign [cmd]."""
        return abs(self.last - self.first)


def command_segments(trial: Trial) -> Segments:
    """Segments of a uniform trial; the bands widen with the noise of a measured command.

    Raises:
        LogError: if the sampling is not uniform.
    """
    span = float(np.ptp(trial.command))
    noise = white_noise([trial.command]) / span if span > 0 else 0.0
    band = float(np.clip(_NOISE_BAND * noise, SegmentRule.hold_band, 0.02))
    return segment(trial, SegmentRule(reversal=max(SegmentRule.reversal, 2 * band), hold_band=band))


def moves_of(trial: Trial, parts: Segments) -> list[Move]:
    """All moves in order of time."""
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

    With a fifth of the time at rest or more, after the rest that it starts with: `steps` where the moves between rests
    take 0.2 s or less, `holds` where it rests most of the time and for 3 s or more each, else `point_to_point`. Else
    by the shape between turns: lines at one pace are a `scan`, else `ramps`; half cosines, or nearly, at one pace are a
    `sine`, whose amplitude may decay; other curves are `sines`. `mixed` is what fits none.
    """
    holds = parts.holds
    lead = holds[0][1] if holds and holds[0][0] == 0 else 0
    rests = [(a, b) for a, b in holds if a >= lead]
    moves = [move for move in moves_of(trial, parts) if move.start >= lead]
    if not moves:
        return "holds"
    held = sum(b - a for a, b in rests) / (len(trial) - lead)
    journeys = _journeys(moves, rests)
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


def _journeys(moves: list[Move], rests: list[tuple[int, int]]) -> list[list[Move]]:
    """Moves with no rest between them."""
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
    if regular and cosine < _COSINE and _one_way([move.height for move in large[1:]], _SMALL * span):
        return "sine"
    return "sines" if lines <= 0.3 else "mixed"


def _regular(moves: list[Move]) -> bool:
    """Whether moves in one direction follow each other at one pace; the first may be longer."""
    middles = np.array([0.5 * (move.start + move.stop) for move in moves[1 if len(moves) > 3 else 0 :]])
    periods = middles[2:] - middles[:-2]
    return periods.size < 2 or float(np.std(periods)) <= _REGULAR * float(np.mean(periods)) + 0.5


def _one_way(heights: list[float], slack: float) -> bool:
    """Whether heights only shrink or only grow, apart from `slack`."""
    steps = np.diff(heights)
    return bool(np.all(steps <= slack) or np.all(steps >= -slack))
