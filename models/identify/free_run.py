"""Free runs of a chain over trials, and their mean square error as fast as the compiled step allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..kernels.chain_kernels import compile_step
from .trial_set import check_trial_set


@dataclass(frozen=True, eq=False)
class ScoredRun:
    """One trial as a fit runs it.

    Attributes:
        commands: the trial's commands behind the chain's warm-up, in which the first is held (W + T,).
        angle: what was measured (T,).
        warmup: samples W.
        start: first sample of the trial that counts.
    """

    commands: Vec
    angle: Vec
    warmup: int
    start: int

    def error(self, theta: Vec, offset_free: bool) -> Vec:
        """Model less measurement over the samples that count, from theta (W + T,); less its mean on request."""
        error = theta[self.warmup + self.start :] - self.angle[self.start :]
        return error - error.mean() if offset_free else error


def scored_runs(chain: Chain, trials: Sequence[Trial], skip_first_flexure: bool) -> list[ScoredRun]:
    """Every trial with the chain's warm-up in front."""
    warmup = chain.settling_samples
    return [
        ScoredRun(
            np.concatenate([np.full(warmup, trial.command[0]), trial.command]),
            trial.angle,
            warmup,
            first_flexure_end(trial) if skip_first_flexure else 0,
        )
        for trial in trials
    ]


class FreeRunLoss:
    """Mean over trials of the mean square error of a chain's free run, in the square of the output's unit.

    Values only, in compiled loops without a step in Python: what a search without derivatives calls 100,000 times.
    """

    def __init__(
        self, chain: Chain, trials: Sequence[Trial], skip_first_flexure: bool = False, offset_free: bool = False
    ) -> None:
        """Prepare the runs.

        Raises:
            FitError: on unusable trials, see `check_trial_set`.
        """
        self._dt = np.array([check_trial_set(trials)])
        self._kernels = compile_step(chain.transition)
        self._offset_free = offset_free
        self.runs = scored_runs(chain, trials, skip_first_flexure)
        self._theta = [np.empty((1, run.commands.size)) for run in self.runs]
        self._rest: Any = chain.rest.map(len(trials))
        self._seen = np.array([[run.angle[0] for run in self.runs]])
        self._held = np.array([[run.commands[0] for run in self.runs]])

    def angles(self, p: Vec) -> list[Vec]:
        """Outputs (W + T,) of each run at parameters p (P,); overwritten by the next call."""
        states = np.asarray(self._rest(self._seen, self._held, np.repeat(p[:, None], self._seen.size, 1))).T
        for run, theta, state in zip(self.runs, self._theta, states, strict=True):
            self._kernels.simulate(
                np.ascontiguousarray(state[None]),
                run.commands[None],
                p,
                self._dt,
                self._kernels.step_constants,
                theta,
            )
        return [theta[0] for theta in self._theta]

    def __call__(self, p: Vec) -> float:
        """Loss at parameters p (P,); infinite where a run is not finite."""
        errors = (run.error(theta, self._offset_free) for run, theta in zip(self.runs, self.angles(p), strict=True))
        loss = sum(float(error @ error) / error.size for error in errors) / len(self.runs)
        return loss if np.isfinite(loss) else np.inf
