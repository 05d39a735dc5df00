"""A trial as the diagnosis runs it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.trial import Trial

Vec = NDArray[np.float64]
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
        correction: what the nominal simulator says beyond the chain that stands for it (T,) [deg]; zero for chains.
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


def runs_of(trials: Sequence[Trial], corrections: Sequence[Vec] | None = None) -> tuple[Run, ...]:
    """Trials in recording order, uniformly sampled, as runs; every sample counts."""
    runs: list[Run] = []
    bent, clock = -np.inf, 0.0
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
                bent_before=max(bent, float(command[0])),
                clock_s=clock,
                correction=np.zeros(len(trial)) if corrections is None else corrections[k],
            )
        )
        bent, clock = max(bent, float(command.max())), clock + trial.duration_s + trial.dt
    return tuple(runs)


def _rest_angle(trial: Trial, still: float) -> float:
    """Angle before the first motion: mean of the samples until the command has moved, noise averaged out."""
    moved = np.flatnonzero(np.abs(trial.command - trial.command[0]) > still)
    stop = max(int(moved[0]) if moved.size else len(trial), 1)
    return float(np.mean(trial.angle[: min(stop, round(1.0 / trial.dt) + 1)]))
