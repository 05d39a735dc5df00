"""A set of causes, fitted and judged on trials that its fit did not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .baseline import Baseline
from .candidate import Candidate
from .fit import fit
from .problem import Problem
from .recording import Run
from .trial_terms import TrialTerms

Vec = NDArray[np.float64]
BLOCK_S = 3.0
LARGEST_FOLDS = 3


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Baseline and some causes, fitted to the development runs.

    Attributes:
        problem: the baseline with the causes.
        q: unknowns fitted to all development runs.
        mse: mean square error of that fit [deg^2].
    """

    problem: Problem
    q: Vec
    mse: float

    @property
    def effects(self) -> frozenset[str]:
        """Names of its causes."""
        return frozenset((*(c.effect for c in self.problem.effects), *self.problem.terms.names))

    @cached_property
    def label(self) -> str:
        """Causes with their variants."""
        return " + ".join((*(c.label for c in self.problem.effects), *self.problem.terms.names)) or "baseline"


@dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis with its errors on held-out trials, in blocks.

    Attributes:
        hypothesis: what was judged.
        energy: sum of squared held-out errors of each block (B,) [deg^2].
        samples: of each block (B,).
        run: run that each block belongs to (B,).
    """

    hypothesis: Hypothesis
    energy: Vec
    samples: Vec
    run: NDArray[np.intp]

    @property
    def mse(self) -> float:
        """Held-out mean square error [deg^2]."""
        return float(self.energy.sum() / self.samples.sum())


@dataclass(frozen=True, eq=False)
class Court:
    """Development runs and how they are split: what every hypothesis is fitted to and judged on.

    Attributes:
        baseline: of every hypothesis.
        runs: development runs.
        evaluations: of a fit from one start.
    """

    baseline: Baseline
    runs: tuple[Run, ...]
    evaluations: int = 12

    @cached_property
    def folds(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the runs held out together; neighbours in the recording order go to different folds."""
        count = min(LARGEST_FOLDS, len(self.runs))
        return tuple(tuple(range(k, len(self.runs), count)) for k in range(count))

    def retuned(self) -> Hypothesis:
        """The baseline alone."""
        problem = Problem(self.baseline)
        found = fit(problem, self.runs, problem.start(self.baseline.nominal, []), 40, 1e-6)
        return Hypothesis(problem, found.q, found.mse)

    def with_causes(
        self, effects: Sequence[Candidate], terms: TrialTerms, z: Vec, starts: Sequence[Sequence[Sequence[float]]]
    ) -> Hypothesis:
        """Fit causes jointly with the baseline, from baseline values z and several values of the effects."""
        problem = Problem(self.baseline, effects, terms)
        found = [fit(problem, self.runs, problem.start(z, values), self.evaluations, 1e-3) for values in starts]
        best = min(found, key=lambda f: f.mse)
        return Hypothesis(problem, best.q, best.mse)

    def polished(self, hypothesis: Hypothesis) -> Hypothesis:
        """The same with its fit run to the end."""
        found = fit(hypothesis.problem, self.runs, hypothesis.q, 60, 1e-6)
        return Hypothesis(hypothesis.problem, found.q, found.mse)

    def judge(self, hypothesis: Hypothesis) -> Judged:
        """Errors on each fold of a fit to the others; with one run, of the fit to it."""
        parts: dict[int, Vec] = {}
        for fold in self.folds:
            rest = [run for k, run in enumerate(self.runs) if k not in fold]
            q = fit(hypothesis.problem, rest, hypothesis.q, self.evaluations, 1e-3).q if rest else hypothesis.q
            parts |= {k: hypothesis.problem.held_out_error(q, self.runs[k]) for k in fold}
        return _blocked(hypothesis, self.runs, [parts[k] for k in range(len(self.runs))])


def _blocked(hypothesis: Hypothesis, runs: Sequence[Run], errors: Sequence[Vec]) -> Judged:
    energy, samples, owner = [], [], []
    for k, (run, error) in enumerate(zip(runs, errors, strict=True)):
        blocks = run.blocks(BLOCK_S)
        blocks = blocks - blocks.min()
        energy.append(np.bincount(blocks, error**2).astype(np.float64))
        samples.append(np.bincount(blocks).astype(np.float64))
        owner.append(np.full(energy[-1].size, k))
    filled = np.concatenate(samples) > 0
    return Judged(
        hypothesis,
        np.concatenate(energy)[filled],
        np.concatenate(samples)[filled],
        np.concatenate(owner)[filled],
    )


def gain(before: Judged, after: Judged) -> tuple[float, float]:
    """Fall of the held-out mean square error and its standard error [deg^2], blocks paired within their runs."""
    difference = before.energy - after.energy
    total = before.samples.sum()
    variance = 0.0
    for k in np.unique(before.run):
        own = difference[before.run == k]
        variance += own.size * float(np.var(own, ddof=1)) if own.size > 1 else float(own[0] ** 2)
    return float(difference.sum() / total), float(np.sqrt(variance) / total)
