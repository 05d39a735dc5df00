"""Three minutes of commands from which a whole device can be identified: steps, holds, sines, reversals at random."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.types import Vec

from .excitation import DecayingSine, RampHoldDraw
from .trajectory import Trajectory

WHOLE_S = 170.0
"""Time that all motions take together at full length, ways back to rest left out [s]."""

_INNER, _OUTER = 0.03, 0.97  # of the stroke


def identification_motions(
    stroke: float, rate: float, random: np.random.Generator, share: float = 1.0
) -> Iterator[tuple[str, Trajectory]]:
    """Commands from 0 to `stroke` by name: what separates lag, delay, creep and hysteresis from each other.

    Steps and ramps with holds, long holds, slow, shrinking and fast sines, and reversals at random. Each begins at 0
    and ends anywhere; a sine may ask for more than `rate`, so that the caller limits the commands.

    Args:
        stroke: greatest command [mm or bar].
        rate: greatest change of the command per second.
        random: what targets, speeds and holds are drawn from.
        share: of the full length, see `WHOLE_S`.

    Raises:
        TrajectoryError: if a number is not positive.
    """
    ends = (_INNER * stroke, _OUTER * stroke)
    steps = RampHoldDraw(max(round(20 * share), 3), ends, (0.1 * rate, 0.8 * rate), (1.0, 4.0), (0.1 * stroke, stroke))
    yield "steps", _cut(steps(random), 38.0 * share)
    holds = RampHoldDraw(max(round(8 * share), 1), ends, (0.05 * rate, 0.3 * rate), (6.0, 9.0), (0.2 * stroke, stroke))
    yield "long_holds", _cut(holds(random), 33.0 * share)
    half = 0.5 * (_OUTER * stroke)
    yield "slow_sine", DecayingSine(half, 0.1, 0.0, 28.0 * share)
    yield "shrinking_sine", DecayingSine(half, 0.25, 0.06, 24.0 * share, lift=1.0)
    yield "fast_sine", DecayingSine(0.3 * stroke, 0.6, 0.0, 14.0 * share, lift=1.0)
    turns = RampHoldDraw(200, ends, (0.05 * rate, 0.5 * rate), (0.0, 0.2), (0.05 * stroke, 0.6 * stroke))
    yield "reversals", _cut(turns(random), 33.0 * share)


@dataclass(frozen=True)
class _Cut:
    """The beginning of a trajectory."""

    whole: Trajectory
    duration_s: float

    def __call__(self, t: ArrayLike) -> Vec:
        return self.whole(np.minimum(np.asarray(t, dtype=np.float64), self.duration_s))


def _cut(whole: Trajectory, longest_s: float) -> Trajectory:
    return _Cut(whole, min(longest_s, whole.duration_s))
