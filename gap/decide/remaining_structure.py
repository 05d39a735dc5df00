"""Structure that a selected effect leaves in the error: shifts shared by groups of trials, and what contradicts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection
from hystmpc.trials.types import Mat, Vec

from .verdict import VerdictSettings

NAME = "configuration_change"
SHIFT = "trial_shift"
UNITS = {"offset_deg": "deg", "gain_share": "1", "width_deg": "deg"}
_LEAST_OF_GROUP = 2
# What shifts of 2 or 3 groups have to explain on trials left out, of what shifts of each trial explain.
_EXPLAINED = {2: 0.87, 3: 0.95}
_RIDGE = 1e-9


@dataclass(frozen=True)
class Configuration:
    """Groups of trials that share offset, gain and width.

    Attributes:
        groups: names of the trials of each group, the largest group first.
        sizes: greatest difference between groups, `offset_deg` [deg at the mean angle], `gain_share` of the gain and,
            where the core has a width, `width_deg` [deg, what it moves the angle by].
        explained: share of what shifts of each trial explain.
    """

    groups: tuple[tuple[str, ...], ...]
    sizes: dict[str, float]
    explained: float


@final
@dataclass(frozen=True, eq=False)
class _Shifts:
    """Normal equations of each trial's offset, gain and width.

    Attributes:
        square: X' X (R, K, K) of the terms.
        product: X' e (R, K) with the error e.
        energy: e' e (R,).
        spread: root mean square of each term over all trials (K,).
    """

    square: Vec
    product: Mat
    energy: Vec
    spread: Vec

    def shared(self, runs: Sequence[int]) -> Vec:
        """Coefficients (K,) that some trials have in common."""
        square = self.square[runs].sum(axis=0)
        ridge = _RIDGE * np.trace(square) * np.eye(len(square))
        return np.asarray(np.linalg.solve(square + ridge, self.product[runs].sum(axis=0)), dtype=np.float64)

    def left(self, run: int, shift: Vec) -> float:
        """Squared error that a trial has with a shift."""
        return float(self.energy[run] - 2 * shift @ self.product[run] + shift @ self.square[run] @ shift)

    def left_out(self, groups: Sequence[Sequence[int]]) -> float:
        """Leave-one-out sum of squared errors, each trial with the shift of the other trials of its group."""
        return sum(self.left(r, self.shared([k for k in group if k != r])) for group in groups for r in group)


def configuration_of(hypothesis: Hypothesis, runs: Sequence[Run]) -> Configuration | None:
    """Groups of trials that explain shifts between trials; None where these scatter, or no effect shifts them.

    Trials are joined by Ward's method (J. Am. Stat. Assoc. 58, 1963) on what their own offset, gain and width move the
    angle by. Each trial is then predicted with the shift that the others of its group share,

        share = (E_all - E_groups) / (E_all - E_own)

    with the squared errors of one shift for all others, of the groups', and of each trial's own. The fewest groups, of
    two trials or more, that reach 0.87 (0.95 for three groups) count. Scatter from trial to trial rarely does: two
    halves of a normal distribution explain 0.64 of it on average.

    Args:
        hypothesis: the corrected simulator.
        runs: all trials.
    """
    if SHIFT not in hypothesis.effects or len(runs) < 2 * _LEAST_OF_GROUP:
        return None
    shifts = _shifts(hypothesis, runs)
    everyone = list(range(len(runs)))
    single = [shifts.shared([k]) for k in everyone]
    alone = sum(shifts.left(k, shift) for k, shift in enumerate(single))
    together = shifts.left_out([everyone])
    if together <= alone:
        return None
    tree = linkage(np.array(single) * shifts.spread, "ward")
    for count, least in _EXPLAINED.items():
        labels = fcluster(tree, count, "maxclust")
        groups = sorted(([k for k in everyone if labels[k] == g] for g in set(labels)), key=lambda g: (-len(g), g))
        if min(len(g) for g in groups) < _LEAST_OF_GROUP:
            continue
        explained = (together - shifts.left_out(groups)) / (together - alone)
        if explained >= least:
            shared = np.array([shifts.shared(g) for g in groups])
            names = tuple(UNITS)[: shared.shape[1]]
            shared[:, 2:] *= shifts.spread[2:]
            sizes = dict(zip(names, np.ptp(shared, axis=0).tolist(), strict=True))
            return Configuration(tuple(tuple(runs[k].name for k in g) for g in groups), sizes, float(explained))
    return None


def _shifts(hypothesis: Hypothesis, runs: Sequence[Run]) -> _Shifts:
    """Offset at the mean angle of all trials, gain and width of each trial, width always where the core has one."""
    problem, q = hypothesis.problem, hypothesis.q
    terms = replace(problem.terms, shift=True, trial_offset=False, frequency_hz=0.0, width=problem.baseline.width)
    parts = [problem.linearised(q, run) for run in runs]
    middle = float(np.mean(np.concatenate([theta for theta, _ in parts])))
    rows, errors = [], []
    for run, (theta, by_q) in zip(runs, parts, strict=True):
        x = terms.columns(run, theta[run.counts], by_q[run.counts])
        x[:, 1] = theta[run.counts] - middle
        if x.shape[1] < 2 + (terms.width >= 0):
            x = np.column_stack([x, np.zeros(len(x))])
        rows.append(x)
        errors.append((theta - run.angle)[run.counts])
    spread = np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))
    return _Shifts(
        np.array([x.T @ x for x in rows]),
        np.array([x.T @ e for x, e in zip(rows, errors, strict=True)]),
        np.array([e @ e for e in errors]),
        spread,
    )


_KNOTS = 10  # of a curve, in each direction
_SLOW_S = 3.0


def structure_left(
    selection: Selection, runs: Sequence[Run], everything: Sequence[Run], floor_mse: float, settings: VerdictSettings
) -> bool:
    """Lack of fit: whether the only selected effect leaves structure that contradicts it.

    A curved gain leaves no other curve of the angle (`remaining_curvature`). Shifts between trials leave no slow change
    within them (`slow_mse`). Widths of single trials belong to groups of trials: else they follow the speed of the
    motions, as with a friction that depends on it.

    Args:
        selection: of the causes.
        runs: development runs.
        everything: all runs; groups of few trials show in all of them alone.
        floor_mse: below which an error carries no evidence [deg^2].
        settings: thresholds.
    """
    chosen, retuned = selection.chosen.hypothesis, selection.baseline.hypothesis
    if chosen.problem.terms.shift and chosen.problem.terms.width >= 0 and configuration_of(chosen, everything) is None:
        return True
    if chosen.effects == {"nonlinear_gain"}:
        before = retuned.mse - floor_mse
        if before <= 0 or chosen.mse < settings.still_open * floor_mse:
            return False
        left = remaining_curvature(chosen, runs, floor_mse)
        return left > settings.curve_left and left * (chosen.mse - floor_mse) > settings.curve_size * before
    if chosen.effects == {"trial_shift"}:
        # The model-form error is slow as well and is part of the floor.
        return slow_mse(chosen, runs) - floor_mse > settings.wander * (retuned.mse - chosen.mse)
    return False


def remaining_curvature(hypothesis: Hypothesis, runs: Sequence[Run], floor_mse: float) -> float:
    """Share of the remaining structural error that two free curves of the simulated angle explain, 0 to 1.

    One curve applies while the simulated angle rises and another while it falls, each piecewise linear between ten
    knots at quantiles of the angle, fitted by least squares to the errors of all runs together. A quadratic and a cubic
    term that imitate a corner, a toe or another branch leave such curves; those of a smooth gain do not.

    Args:
        hypothesis: fitted to the runs.
        runs: development runs.
        floor_mse: below which an error carries no evidence [deg^2].
    """
    angles, errors = [], []
    for run in runs:
        theta = hypothesis.problem.angles(hypothesis.q, run)
        rises = np.gradient(theta) >= 0
        angles.append(np.stack([theta, rises], axis=1)[run.counts])
        errors.append((run.angle - theta)[run.counts])
    theta, rises = np.concatenate(angles).T
    error = np.concatenate(errors)
    structural = float(np.mean(error**2)) - floor_mse
    if structural <= 0:
        return 0.0
    columns = _hat_functions(theta)
    columns = np.concatenate([columns * rises[:, None], columns * (1 - rises)[:, None]], axis=1)
    weights = np.linalg.lstsq(columns, error, rcond=None)[0]
    explained = float(np.mean(error**2) - np.mean((error - columns @ weights) ** 2))
    return float(np.clip(explained / structural, 0.0, 1.0))


def slow_mse(hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
    """Mean square of the remaining error's means over three seconds [deg^2], slow change within trials."""
    total, count = 0.0, 0
    for run in runs:
        error, blocks = hypothesis.problem.error(hypothesis.q, run)[0], run.blocks(_SLOW_S)
        blocks = blocks - blocks.min()
        samples = np.bincount(blocks)
        means = np.bincount(blocks, error)[samples > 0] / samples[samples > 0]
        total, count = total + float(np.sum(means**2)), count + means.size
    return total / count


def _hat_functions(x: Vec) -> Mat:
    """Piecewise linear functions (T, K), one at each knot."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _KNOTS)))
    return np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)
