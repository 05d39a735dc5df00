"""Excitation: speeds, holds, repeats and ends of a set of motions, and the effects that they can distinguish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.segments import Segments
from hystmpc.trials.trial import Trial

from .motion_type import STEP_S, MotionType, Move, command_segments, motion_type, moves_of
from .noise_floor import RepeatedMotion, find_repeats

LONG_HOLD_S = 30.0
_SPEED_RATIO = 1.6  # speeds nearer than that are one speed
_FAST_S, _FAST_HEIGHT, _FAST_COUNT = 1 / 3, 0.3, 8  # half periods of 1.5 Hz or more; of the range; moves
_STEP_HEIGHT, _STEP_COUNT = 0.1, 3
_RAMP_HEIGHT = 0.1
_LOW, _LOW_S, _LOW_VISITS = 0.1, 3.0, 3
_LEVEL, _UPPER = 0.08, 0.4  # turning points nearer than that are at one level; of the range
_OPENING_LEVEL, _OPENING_TIME = 0.02, 0.1


@dataclass(frozen=True)
class Excitation:
    """Excitation by the commands of all trials; shares refer to the range of all commands.

    Attributes:
        longest_hold_s: longest rest of the command [s]; 0 without one.
        fastest: 99th percentile of its speed while it moves [cmd/s].
        ramp_speeds: speeds of its constant-speed moves that are a factor of 1.6 or more apart, slowest first [cmd/s].
        steps: moves of a tenth of the range or more within 0.2 s.
        fast_small: moves of less than a third of a second (1.5 Hz and above) and of less than 30 %.
        low_s: time within the lowest tenth [s].
        top_levels: distinct turning levels, 8 % apart, in the upper 60 %.
        opening_repeated: whether the first rise of the first trial is repeated, in it or a later trial.
    """

    motions: tuple[MotionType, ...]
    repeats: tuple[RepeatedMotion, ...]
    longest_hold_s: float
    fastest: float
    ramp_speeds: tuple[float, ...]
    steps: int
    fast_small: int
    low_s: float
    low_visits: int
    top_levels: int
    opening_repeated: bool

    @property
    def has_holds(self) -> bool:
        """Whether the command rests for 3 s or more."""
        return self.longest_hold_s >= 3.0

    @property
    def sine_only(self) -> bool:
        """Whether every trial is one sine."""
        return all(motion == "sine" for motion in self.motions)


def excitation_of(trials: Sequence[Trial], ordered: bool = True) -> Excitation:
    """Excitation by uniform trials at one rate, from their commands alone.

    Args:
        ordered: whether they are in recording order; if not, any of them may have been the first.
    """
    dt = trials[0].dt
    parts = [command_segments(trial) for trial in trials]
    moves = [moves_of(trial, part) for trial, part in zip(trials, parts, strict=True)]
    low = min(float(trial.command.min()) for trial in trials)
    span = max(float(trial.command.max()) for trial in trials) - low
    all_moves = [move for trial_moves in moves for move in trial_moves]
    bottom = [trial.command <= low + _LOW * span for trial in trials]
    holds = [stop - start for part in parts for start, stop in part.holds]
    firsts = range(1 if ordered else len(trials))  # trials that may have been recorded first
    return Excitation(
        motions=tuple(motion_type(trial, part) for trial, part in zip(trials, parts, strict=True)),
        repeats=find_repeats(trials),
        longest_hold_s=max(holds, default=0) * dt,
        fastest=_fastest(trials, span),
        ramp_speeds=_ramp_speeds(all_moves, dt, _RAMP_HEIGHT * span),
        steps=sum(move.samples * dt <= STEP_S and move.height >= _STEP_HEIGHT * span for move in all_moves),
        fast_small=sum(move.samples * dt < _FAST_S and 0.01 < move.height / span < _FAST_HEIGHT for move in all_moves),
        low_s=sum(int(np.count_nonzero(inside)) for inside in bottom) * dt,
        low_visits=sum(int(np.count_nonzero(np.diff(b.astype(np.int8), prepend=0) == 1)) for b in bottom),
        top_levels=_top_levels(trials, parts, low, span),
        opening_repeated=all(_opening_repeated([*moves[k:], *moves[:k]], span) for k in firsts),
    )


def _fastest(trials: Sequence[Trial], span: float) -> float:
    speeds = np.concatenate([np.abs(np.diff(trial.command)) / trial.dt for trial in trials])
    moving = speeds[speeds > 1e-3 * span]
    return float(np.percentile(moving, 99)) if moving.size else 0.0


def _ramp_speeds(moves: Sequence[Move], dt: float, least: float) -> tuple[float, ...]:
    ramps = [m for m in moves if m.straight and m.height >= least and m.samples * dt > STEP_S]
    distinct: list[float] = []
    for speed in sorted(m.height / (m.samples * dt) for m in ramps):
        if not distinct or speed > _SPEED_RATIO * distinct[-1]:
            distinct.append(speed)
    return tuple(distinct)


def _top_levels(trials: Sequence[Trial], parts: Sequence[Segments], low: float, span: float) -> int:
    levels: list[float] = []
    for trial, part in zip(trials, parts, strict=True):
        turns = np.concatenate([trial.command[:1], trial.command[part.reversals], trial.command[-1:]])
        upper = (turns[1:-1] > turns[:-2]) & (turns[1:-1] > turns[2:]) & (turns[1:-1] > low + _UPPER * span)
        levels += turns[1:-1][upper].tolist()
    distinct: list[float] = []
    for level in sorted(levels):
        if not distinct or level > distinct[-1] + _LEVEL * span:
            distinct.append(level)
    return len(distinct)


def _opening_repeated(moves: Sequence[Sequence[Move]], span: float) -> bool:
    """Whether a later move is equal to the first one in level and, to a tenth, in time."""
    if not moves or not moves[0]:
        return False
    opening = moves[0][0]
    later = [move for trial_moves in moves for move in trial_moves][1:]
    return any(
        abs(move.first - opening.first) <= _OPENING_LEVEL * span
        and abs(move.last - opening.last) <= _OPENING_LEVEL * span
        and abs(move.samples - opening.samples) <= _OPENING_TIME * opening.samples + 1
        for move in later
    )


@dataclass(frozen=True)
class ConfusableEffects:
    """Effects with similar responses to some motions.

    Attributes:
        effects: their public names; two names of one class if `one_class`.
        separable: whether these motions can distinguish them.
        present: the part of the separating motion in these motions.
        alike_in_sine, alike_in_hold: share of one effect's gap that the other reproduces on a single 0.2 Hz sine, and
            on a ramp with a hold of 8 s (study on a Prandtl-Ishlinskii model with three plays, 50 Hz).
        one_class: equal in command and angle for every motion, by algebra.
    """

    effects: tuple[str, ...]
    separable: bool
    separated_by: str
    present: str
    alike_in_sine: float
    alike_in_hold: float
    one_class: bool = False


_PAIRS: tuple[tuple[tuple[str, ...], str, float, float], ...] = (
    (("lag", "delay", "rate_dependence"), "fast steps and small sines of 2 to 4 Hz", 1.0, 0.99),
    (("actuator lag", "sensor lag"), "nothing; reported as one class, lag", 0.99, 1.0),
    (("lag", "creep"), "holds of 3 s and more", 0.95, 0.3),
    (("creep", "first_flexure"), "the opening motion repeated", 0.97, 0.3),
    (("drift", "creep"), f"holds of {LONG_HOLD_S:g} s and more, and a repeat of a motion", 0.96, 0.78),
    (("stick_slip", "lag"), "ramps at three speeds", 0.83, 0.54),
    (
        ("gravity", "nonlinear stretch"),
        "another orientation or load; reported as one class, nonlinear_gain",
        0.99,
        0.98,
    ),
    (
        ("slack", "nonlinear_gain"),
        "another pretension; slow moves near the lowest command, three times and more",
        0.63,
        0.38,
    ),
    (("contact", "nonlinear_gain"), "the end approached from three amplitudes and more", 0.71, 0.8),
)
"""Effects, the motion that separates them, and `alike_in_sine` and `alike_in_hold` of `ConfusableEffects`."""


def confusability(e: Excitation) -> tuple[ConfusableEffects, ...]:
    """Table of confusable effects, evaluated for these motions."""
    hold = f"longest hold {e.longest_hold_s:.3g} s" if e.longest_hold_s else "no hold"
    repeats = f"{len(e.repeats)} pairs of repeats" if e.repeats else "no repeat"
    speeds = ", ".join(f"{speed:.3g}" for speed in e.ramp_speeds) or "none"
    opening = "comes" if e.opening_repeated else "does not come"
    low = f"{e.low_s:.3g} s in {e.low_visits} visits to the lowest tenth of the command"
    signals = "command and angle only"
    fast = e.steps >= _STEP_COUNT or e.fast_small >= _FAST_COUNT
    dwells = e.low_s >= _LOW_S and e.low_visits >= _LOW_VISITS
    judged: tuple[tuple[bool | None, str], ...] = (  # in the order of `_PAIRS`; None: one class whatever the motion
        (fast, f"{e.steps} fast steps, {e.fast_small} small moves faster than 1.5 Hz"),
        (None, signals),
        (e.has_holds, hold),
        (e.opening_repeated, f"the opening motion {opening} again"),
        (e.longest_hold_s >= LONG_HOLD_S and bool(e.repeats), f"{hold}, {repeats}"),
        (len(e.ramp_speeds) >= 3, f"ramps at distinct speeds: {speeds}"),
        (None, signals),
        (dwells and not e.sine_only, low),
        (e.top_levels >= 3, f"{e.top_levels} distinct upper turning points"),
    )
    return tuple(
        ConfusableEffects(effects, bool(separable), motion, text, in_sine, in_hold, one_class=separable is None)
        for (effects, motion, in_sine, in_hold), (separable, text) in zip(_PAIRS, judged, strict=True)
    )
