"""Trials as an identification runs them, and their squared errors in blocks of a few seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

_SETTLED_SHARE = 0.002  # of the command's range: a start that moves less is at rest


@dataclass(frozen=True, eq=False)
class Run:
    """One trial, or a part of one that counts.

    Attributes:
        name: of the trial.
        command, angle: (T,) [cmd], [deg].
        dt_s: sample time [s].
        rest_command, rest_angle: where the device rested before [cmd], [deg].
        counts: samples that are scored (T,).
        bent_before: greatest command of all trials recorded before [cmd]; the rest command for the first.
        clock_s: time recorded before this trial [s].
        correction: angle of the nominal simulator less that of the chain that represents it (T,) [deg]; zero for a
            chain.
    """

    name: str
    command: Vec
    angle: Vec
    dt_s: float
    rest_command: float
    rest_angle: float
    counts: NDArray[np.bool_]
    bent_before: float
    clock_s: float
    correction: Vec

    def blocks(self, seconds: float) -> NDArray[np.intp]:
        """Number of the block that each counted sample belongs to."""
        length = max(round(seconds / self.dt_s), 1)
        return np.flatnonzero(self.counts) // length


@dataclass(frozen=True)
class Before:
    """What a device has seen when a trial begins.

    Attributes:
        bent: greatest command of all trials recorded before [cmd]; minus infinity for the first.
        clock_s: time recorded before [s].
    """

    bent: float = -np.inf
    clock_s: float = 0.0

    @classmethod
    def each(cls, trials: Sequence[Trial]) -> tuple[Before, ...]:
        """Of every trial, in recording order."""
        found = [cls()]
        for trial in trials:
            last = found[-1]
            bent = max(last.bent, float(trial.command.max()))
            found.append(cls(bent, last.clock_s + trial.duration_s + trial.dt))
        return tuple(found[:-1])


def runs_of(
    trials: Sequence[Trial], corrections: Sequence[Vec] | None = None, before: Sequence[Before] | None = None
) -> tuple[Run, ...]:
    """Trials in recording order, uniformly sampled, as runs; every sample counts.

    Args:
        trials: all that were recorded, or some of them.
        corrections: see `Run.correction`.
        before: of each trial, where trials in between were left out.
    """
    runs: list[Run] = []
    before = Before.each(trials) if before is None else before
    span = max(float(np.ptp(trial.command)) for trial in trials)
    for k, trial in enumerate(trials):
        command = np.ascontiguousarray(trial.command)
        runs.append(
            Run(
                name=trial.source,
                command=command,
                angle=np.ascontiguousarray(trial.angle),
                dt_s=trial.dt,
                rest_command=float(command[0]),
                rest_angle=_rest_angle(trial, _SETTLED_SHARE * span),
                counts=np.ones(len(trial), dtype=np.bool_),
                bent_before=max(before[k].bent, float(command[0])),
                clock_s=before[k].clock_s,
                correction=np.zeros(len(trial)) if corrections is None else corrections[k],
            )
        )
    return tuple(runs)


def _rest_angle(trial: Trial, still: float) -> float:
    """Angle before the first motion: mean of the samples until the command has moved, noise averaged out."""
    moved = np.flatnonzero(np.abs(trial.command - trial.command[0]) > still)
    stop = max(int(moved[0]) if moved.size else len(trial), 1)
    return float(np.mean(trial.angle[: min(stop, round(1.0 / trial.dt) + 1)]))


_BLOCK_S = 3.0


@dataclass(frozen=True, eq=False)
class Blocks:
    """Squared errors in blocks; blocks without a sample are left out.

    Attributes:
        energy: sum of squared errors of each block (B,) [deg^2].
        samples: of each block (B,).
        run: number of the run that each belongs to (B,).
    """

    energy: Vec
    samples: Vec
    run: NDArray[np.intp]

    @property
    def mse(self) -> float:
        """Mean square error [deg^2]."""
        return float(self.energy.sum() / self.samples.sum())


def blocks_of(errors: Sequence[Vec], runs: Sequence[Run]) -> Blocks:
    """Errors (C,) of the counted samples of each run, in blocks of three seconds."""
    energy, samples, owner = [], [], []
    for k, (error, run) in enumerate(zip(errors, runs, strict=True)):
        blocks = run.blocks(_BLOCK_S)
        blocks = blocks - blocks.min()
        energy.append(np.bincount(blocks, error**2).astype(np.float64))
        samples.append(np.bincount(blocks).astype(np.float64))
        owner.append(np.full(energy[-1].size, k))
    filled = np.concatenate(samples) > 0
    return Blocks(np.concatenate(energy)[filled], np.concatenate(samples)[filled], np.concatenate(owner)[filled])
