"""Joint fits of a baseline and possible causes of a gap, and their errors on held-out trials."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Index, Mat, Vec

from ..chain import Chain
from ..effects.effect import CORE, Candidate
from .baseline import Baseline
from .least_squares import minimise_in_boxes
from .problem import Problem, TrialTerms
from .runs import AS_IT_IS, Blocks, Run, RunsTogether, blocks_of

_PARTS = 3  # of the time of a single run
_ONE_VALUE = 0.1  # share of an input's range below which it counts as one value
_TO_CONVERGENCE = (60, 1e-6)  # greatest number of evaluations, and tolerance
_LEAST_ERROR = 1e-300
_COMMON = 1.0  # weight, in samples, of the mean of the trials' terms
_HELD = 1e-10  # share of the greatest curvature: keeps undetermined unknowns at their start


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Baseline with some causes, fitted to the development runs.

    Attributes:
        q: fitted unknowns (Q,).
        mse: mean square error of that fit [deg^2].
    """

    problem: Problem
    q: Vec
    mse: float

    @property
    def effects(self) -> frozenset[str]:
        """Names of the causes."""
        return frozenset((*(c.effect for c in self.problem.effects), *self.problem.terms.names))

    @property
    def z(self) -> Vec:
        """Baseline unknowns (Z,)."""
        return self.problem.retuned(self.q)

    @property
    def values(self) -> list[list[float]]:
        """Free parameters of each cause, as a fit starts from them."""
        return [list(values.values()) for values in self.problem.effect_values(self.q)]

    @property
    def chain(self) -> Chain:
        """Chain with the fitted parameters."""
        return self.problem.fitted_chain(self.q)

    def angles(self, run: Run) -> Vec:
        """Angles (T,) of a free run [deg]."""
        return self.problem.angles(self.q, run)

    def error(self, run: Run) -> Vec:
        """Angle minus measurement where it counts (C,) [deg], without terms of the trial."""
        return self.problem.error(self.q, run)[0]

    def held_out_errors(self, runs: Sequence[Run]) -> tuple[Vec, ...]:
        """Angle minus measurement of each run (C,) [deg]; terms of a trial are estimated on its other blocks."""
        return self.problem.held_out_errors(self.q, runs)

    @cached_property
    def label(self) -> str:
        """Causes with their variants."""
        return " + ".join((*(c.label for c in self.problem.effects), *self.problem.terms.names)) or "baseline"


def fit_problem(
    problem: Problem,
    runs: Sequence[Run],
    start: Vec,
    evaluations: int = 25,
    tolerance: float = 1e-4,
    white: Vec = AS_IT_IS,
) -> Hypothesis:
    """Fit a hypothesis to runs from one start; counted samples weigh the same.

    Args:
        runs: trials; their counted samples weigh the same.
        start: unknowns (Q,); brought within the bounds.
        evaluations: greatest number of free runs over all trials.
        tolerance: relative change of the error at which the fit ends.
        white: filter of the errors whose squares are summed (`whitening`).
    """
    search = _ErrorProducts(problem, runs, start, white)
    ends, units = (problem.lower, problem.upper), problem.units(start)
    q = minimise_in_boxes(search.products, start, ends, units, evaluations, tolerance)
    return Hypothesis(problem, q, search.mse(q))


class _ErrorProducts:
    """Errors and derivatives of all runs, and the pull to the start."""

    def __init__(self, problem: Problem, runs: Sequence[Run], start: Vec, white: Vec) -> None:
        self._problem, self._start, self._white, self._groups = problem, start, white, RunsTogether.groups(runs)
        self._samples = sum(int(run.counts.sum()) for run in runs)
        self._energies: dict[bytes, float] = {}

    def mse(self, q: Vec) -> float:
        """Mean square of the errors that count [deg^2]."""
        if q.tobytes() not in self._energies:
            self.products(q)
        return self._energies[q.tobytes()] / self._samples

    def products(self, q: Vec) -> Mat:
        """Products of derivatives and errors (Q + 1, Q + 1)."""
        products = [self._problem.products(q, group, self._white) for group in self._groups]
        square, common = (
            np.sum([normal for normal, _ in products], axis=0),
            [row for _, rows in products for row in rows],
        )
        self._energies[q.tobytes()] = float(square[-1, -1])
        square = square + self._pull(square, q)
        if common:
            mean = np.mean(common, axis=0)
            square += _COMMON * self._samples * mean.T @ mean
            if self._problem.offsets_by_inputs:  # one sample each: enough for what the trials have in common
                square += np.sum([row.T @ row for row in common], axis=0)
        return square

    def _pull(self, square: Vec, q: Vec) -> Vec:
        """Products of derivatives and errors of the distance from the start and of roughness."""
        away, rough = q - self._start, self._problem.roughness
        pull = np.eye(q.size + 1)
        pull[-1, :-1] = pull[:-1, -1] = away
        pull[-1, -1] = away @ away
        pull *= _HELD * np.max(np.diag(square)[:-1], initial=0.0)
        if len(rough):
            rows = np.column_stack([rough, rough @ q])
            pull += rows.T @ rows
        return pull


@dataclass(frozen=True, eq=False)
class InParts:
    """Error energies by which a lag, a delay and a rate dependence are compared, see `timing_rivals`.

    Attributes:
        held_out: of errors on parts of all trials, fitted to the other parts (B,) [deg^2].
        quick: of whitened errors of a fit to all trials (B,) [deg^2].
        free: free parameters of the effect in that fit.
        floor_mse: error of sensor noise and model form [deg^2].
        form_share: part of it that is of the model form.
    """

    held_out: Vec
    quick: Vec
    free: int
    floor_mse: float = 0.0
    form_share: float = 0.0

    @property
    def expected(self) -> float:
        """Expected energy of whitened errors on other trials: (B + Q) / (B - Q) times that of the fit [deg^2]."""
        blocks = self.quick.size
        return float(self.quick.sum()) * (blocks + self.free) / max(blocks - self.free, 1)

    def at(self, blocks: NDArray[np.intp]) -> InParts:
        """Energies of some blocks."""
        return replace(self, held_out=self.held_out[blocks], quick=self.quick[blocks])

    def with_trials(self, energy: Vec) -> InParts:
        """Energies with the blocks of further trials without whitened errors."""
        quick = np.concatenate([self.quick, np.zeros(energy.size)])
        return replace(self, held_out=np.concatenate([self.held_out, energy]), quick=quick)


@dataclass(frozen=True, eq=False)
class HeldOutErrors(Blocks):
    """Errors of a hypothesis on held-out trials, in blocks.

    Attributes:
        errors: of each run where it counts (C,) [deg].
        fold_q: unknowns (Q,) fitted without each fold.
        parts: errors by which a lag, a delay and a rate dependence are compared; None where they were not.
    """

    hypothesis: Hypothesis
    errors: tuple[Vec, ...]
    fold_q: tuple[Vec, ...]
    parts: InParts | None = None

    def at(self, blocks: Index) -> HeldOutErrors:
        """Errors in some blocks, as a resample draws them; those of each run stay whole."""
        return replace(
            self,
            energy=self.energy[blocks],
            samples=self.samples[blocks],
            run=self.run[blocks],
            parts=self.parts and self.parts.at(blocks),
        )


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Cross-validation of hypotheses over folds of the development runs.

    Attributes:
        evaluations: of a fit from one start.
        tolerance, search_tolerance: relative fall of the error at which a fit ends, and at which one of many starts and
            forms does that are compared before the best are `finished`.
        in_time: whether a single run is held out in thirds of its time; else its training error counts.
        most_folds: greatest number of folds. Of few logs each is often the only one of its kind: with as many folds as
            logs, a fit misses no other one.
    """

    baseline: Baseline
    runs: tuple[Run, ...]
    evaluations: int = 12
    tolerance: float = 1e-3
    search_tolerance: float = 1e-2
    in_time: bool = False
    most_folds: int = 3

    @cached_property
    def folds(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the runs held out together; neighbours in the recording order are in different folds."""
        count = min(self.most_folds, len(self.runs))
        return tuple(tuple(range(k, len(self.runs), count)) for k in range(count))

    def retuned(self) -> Hypothesis:
        """Baseline without causes, fitted to all runs."""
        problem = Problem(self.baseline)
        return fit_problem(problem, self.runs, problem.start(self.baseline.nominal, []), 40, 1e-6)

    def with_causes(
        self,
        effects: Sequence[Candidate],
        terms: TrialTerms,
        z: Vec,
        starts: Sequence[Sequence[Sequence[float]]],
        tolerance: float | None = None,
    ) -> Hypothesis:
        """Causes fitted jointly with the baseline, from baseline values z and several values of the effects."""
        problem, ends = Problem(self.baseline, effects, terms), tolerance or self.tolerance
        fits = (self._fitted(problem, problem.start(z, values), ends) for values in starts)
        return min(fits, key=lambda fit: fit.mse)

    def _fitted(self, problem: Problem, start: Vec, tolerance: float) -> Hypothesis:
        """Fit from one start; a selection asks for some of them again."""
        key = problem.effects, problem.terms, start.tobytes(), tolerance
        if key not in self._known:
            self._known.setdefault(key, fit_problem(problem, self.runs, start, self.evaluations, tolerance))
        return self._known[key]

    def finished(self, hypothesis: Hypothesis) -> Hypothesis:
        """Hypothesis of a search, fitted from where that ended."""
        return fit_problem(hypothesis.problem, self.runs, hypothesis.q, self.evaluations, self.tolerance)

    @cached_property
    def _known(self) -> dict[tuple[object, ...], Hypothesis]:
        """Fits by their causes and start."""
        return {}

    def with_one_more(self, base: Hypothesis, candidate: Candidate) -> Hypothesis:
        """One more cause, searched from its starts and the present values of a hypothesis, jointly with all others."""
        effects, begin = (*base.problem.effects, candidate), candidate.starts
        if candidate.variant == CORE:
            begin = self.baseline.begin.get(candidate.effect, begin)
        starts = [[*base.values, start] for start in begin]
        return self.with_causes(effects, base.problem.terms, base.z, starts, self.search_tolerance)

    def without(self, hypothesis: Hypothesis, dropped: AbstractSet[str]) -> Hypothesis:
        """Hypothesis refitted without some of its causes, from its present values."""
        problem = hypothesis.problem
        kept = [(c, v) for c, v in zip(problem.effects, hypothesis.values, strict=True) if c.effect not in dropped]
        terms = replace(
            problem.terms,
            shift=problem.terms.shift and "trial_shift" not in dropped,
            frequency_hz=0.0 if "periodic_disturbance" in dropped else problem.terms.frequency_hz,
        )
        return self.with_causes([c for c, _ in kept], terms, hypothesis.z, [[v for _, v in kept]])

    def polished(self, hypothesis: Hypothesis) -> Hypothesis:
        """Hypothesis fitted to convergence."""
        return fit_problem(hypothesis.problem, self.runs, hypothesis.q, *_TO_CONVERGENCE)

    def fitted_errors(self, hypothesis: Hypothesis) -> Blocks:
        """Training errors, in the blocks of `judge`."""
        return blocks_of([hypothesis.error(run) for run in self.runs], self.runs)

    @cached_property
    def _splits(self) -> tuple[tuple[tuple[Run, ...], dict[int, Run]], ...]:
        """Runs to fit and held-out runs by number, for each fold; in time, thirds of all runs.

        Thirds are held out of a single run, and of runs of which a fold would keep one value of a measured input alone.
        """
        if (len(self.runs) > 1 and self._says_all) or not self.in_time:
            return tuple(
                (tuple(run for k, run in enumerate(self.runs) if k not in fold), {k: self.runs[k] for k in fold})
                for fold in self.folds
            )
        thirds = [
            [np.isin(np.arange(run.counts.size), part) for part in np.array_split(np.flatnonzero(run.counts), _PARTS)]
            for run in self.runs
        ]
        return tuple(
            (
                tuple(replace(run, counts=run.counts & ~at[j]) for run, at in zip(self.runs, thirds, strict=True)),
                {k: replace(run, counts=thirds[k][j]) for k, run in enumerate(self.runs)},
            )
            for j in range(_PARTS)
        )

    @property
    def _says_all(self) -> bool:
        """Whether the runs beside each fold show more than one value of every measured input that varies."""
        for name in self.runs[0].inputs:
            ends = np.array([(run.inputs[name].min(), run.inputs[name].max()) for run in self.runs])
            for fold in self.folds:
                rest = np.delete(ends, fold, axis=0)
                if rest.size and np.ptp(rest) < _ONE_VALUE * np.ptp(ends):
                    return False
        return True

    def judge(self, hypothesis: Hypothesis) -> HeldOutErrors:
        """Errors on each fold of a fit to the others; training errors of a single run that is not split."""
        problem, fold_q = hypothesis.problem, []
        parts: list[list[Vec]] = [[] for _ in self.runs]
        for rest, held_out in self._splits:
            q = fit_problem(problem, rest, hypothesis.q, self.evaluations, self.tolerance).q if rest else hypothesis.q
            fold_q.append(q)
            for k, error in zip(held_out, problem.held_out_errors(q, list(held_out.values())), strict=True):
                parts[k].append(error)
        errors = tuple(map(np.concatenate, parts))
        blocks = blocks_of(errors, self.runs)
        return HeldOutErrors(blocks.energy, blocks.samples, blocks.run, hypothesis, errors, tuple(fold_q))

    def left_out(self, judged: HeldOutErrors) -> tuple[Vec, ...]:
        """Held-out measurement minus free run (C,) [deg] of every run, terms of single trials included.

        Fits to the other trials go on to convergence here. One that ends early, as in a selection, still knows the
        trials that are held out by its start, the fit to all trials.
        """
        problem = judged.hypothesis.problem
        parts: list[list[Vec]] = [[] for _ in self.runs]
        for (rest, held_out), fold_q in zip(self._splits, judged.fold_q, strict=True):
            q = fit_problem(problem, rest, fold_q, *_TO_CONVERGENCE).q if rest else fold_q
            for k, run in held_out.items():
                parts[k].append((run.angle - problem.angles(q, run))[run.counts])
        return tuple(map(np.concatenate, parts))


def gain(before: Blocks, after: Blocks) -> tuple[float, float]:
    """Fall of the held-out mean square error and its standard error [deg^2], blocks paired within their runs."""
    fall, error = _paired(before.energy - after.energy, before.run)
    total = before.samples.sum()
    return float(fall / total), float(error / total)


def sureness(before: Blocks, after: Blocks) -> float:
    """Number of standard errors by which the held-out error falls, in squares or RMS values of blocks: the greater.

    A cause that acts in few blocks, as in fast steps alone, has a scatter of squares as large as its effect. The root
    lets each block count by its error, not by its square (Bartlett, The use of transformations, Biometrics 3, 1947).
    """
    squares = _paired(before.energy - after.energy, before.run)
    roots = _paired(np.sqrt(before.energy) - np.sqrt(after.energy), before.run)
    return max(fall / max(error, _LEAST_ERROR) for fall, error in (squares, roots))


def _paired(difference: Vec, runs: NDArray[np.intp]) -> tuple[float, float]:
    """Sum of the differences of blocks and its standard error by their scatter within the runs."""
    size = np.bincount(runs)
    apart = difference - (np.bincount(runs, difference) / np.maximum(size, 1))[runs]
    squares = np.bincount(runs, apart**2) * size / np.maximum(size - 1, 1)
    alone = difference[size[runs] == 1]
    return float(difference.sum()), float(np.sqrt(squares.sum() + alone @ alone))


def mean_square_difference(one: HeldOutErrors, other: HeldOutErrors) -> float:
    """Mean square difference of the predictions of two hypotheses on held-out trials [deg^2]."""
    differences = [a - b for a, b in zip(one.errors, other.errors, strict=True)]
    return float(sum(np.sum(d**2) for d in differences) / sum(d.size for d in differences))
