"""Trials of any rate and number as a diagnosis takes them: gaps cut off, at one rate, no more than can be afforded."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial, gap_limit_s, resample

from .motion_type import MotionType, command_segments, motion_type
from .recording import Before
from .workload import Workload, affordable

MOST_HZ = 50.0
"""Greatest rate of a diagnosis: tip motions end at a few Hz, and time grows with the rate."""

LEAST_S = 2.0
"""Shortest trial [s]."""

_NEAR_RATE = 1.5


@dataclass(frozen=True, eq=False)
class ChosenTrials:
    """Trials that are diagnosed.

    Attributes:
        trials: uniform, all at one rate, in recording order.
        recorded: the same as recorded, gaps cut off.
        given: the same as given.
        before: what the device had seen before each, trials that were not chosen among it.
        dt: sample interval of `trials` [s].
        workload: what a diagnosis of them costs.
    """

    trials: tuple[Trial, ...]
    recorded: tuple[Trial, ...]
    given: tuple[Trial, ...]
    before: tuple[Before, ...]
    dt: float
    workload: Workload

    @property
    def left_out(self) -> tuple[str, ...]:
        """One line on those that were not chosen, or none."""
        return (self.workload.note,) if self.workload.note else ()

    def only(self, kept: Sequence[bool]) -> ChosenTrials:
        """Some of the trials."""
        return replace(
            self,
            trials=tuple(itertools.compress(self.trials, kept)),
            recorded=tuple(itertools.compress(self.recorded, kept)),
            given=tuple(itertools.compress(self.given, kept)),
            before=tuple(itertools.compress(self.before, kept)),
        )


def choose_trials(trials: Sequence[Trial], facts: ModelMetadata, fixed: bool, seed: int) -> ChosenTrials:
    """Choose trials that can be afforded and bring them to one rate; of those that are cut, their first part.

    Args:
        trials: as given, in recording order.
        facts: of the simulator.
        fixed: whether its own rate is the only one that it holds at.
        seed: of the choice.

    Raises:
        GapError: if the gaps of a trial leave no part that is long enough.
        LogError: if the simulator's rate is fixed and above a log's.
    """
    recorded = [_longest_part(trial) for trial in trials]
    rate = _common_rate(recorded, facts, fixed)
    uniform = [resample(trial, rate) for trial in recorded]
    before = Before.each(uniform)
    motions: list[MotionType] = [motion_type(trial, command_segments(trial)) for trial in uniform]
    workload = affordable(uniform, motions, seed)
    kept = list(zip(workload.kept, workload.samples, strict=True))
    return ChosenTrials(
        tuple(_first(uniform[k], uniform[k].t[count - 1]) for k, count in kept),
        tuple(_first(recorded[k], uniform[k].t[count - 1]) for k, count in kept),
        tuple(_first(trials[k], uniform[k].t[count - 1]) for k, count in kept),
        tuple(before[k] for k, _ in kept),
        1.0 / rate,
        workload,
    )


def _first(trial: Trial, end_s: float) -> Trial:
    """The trial up to a time [s], itself where no more than a sample of it comes later."""
    stop = int(np.searchsorted(trial.t, end_s, side="right"))
    return trial if trial.t[-1] - end_s <= 1.5 * trial.dt else trial.select(0, stop)


def _longest_part(trial: Trial) -> Trial:
    cuts = np.flatnonzero(np.diff(trial.t) > gap_limit_s(trial.dt)) + 1
    edges = [0, *cuts.tolist(), len(trial)]
    start, stop = max(itertools.pairwise(edges), key=lambda e: trial.t[e[1] - 1] - trial.t[e[0]])
    if trial.t[stop - 1] - trial.t[start] < LEAST_S:
        raise GapError(f"{trial.source}: {cuts.size} gaps leave no part of {LEAST_S:g} s or more")
    return trial.select(start, stop) if cuts.size else trial


def _common_rate(trials: Sequence[Trial], facts: ModelMetadata, fixed: bool) -> float:
    own = 1.0 / facts.dt_s
    if fixed:
        return own
    slowest = min(MOST_HZ, *(1.0 / trial.dt for trial in trials))
    near = slowest / _NEAR_RATE <= own <= min(_NEAR_RATE * slowest, MOST_HZ)
    return own if near else slowest
