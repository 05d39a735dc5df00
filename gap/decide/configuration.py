"""Configuration change: shifts between trials that are the same within groups of trials, as after a new mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Mat, Vec

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

    def name(self, effect: str) -> str:
        """What an effect is called with these groups."""
        return NAME if effect == SHIFT else effect


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
        """Sum of squared errors of all trials, each with the shift of the others of its group."""
        return sum(self.left(r, self.shared([k for k in own if k != r])) for own in groups for r in own)


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
    own = [shifts.shared([k]) for k in everyone]
    alone = sum(shifts.left(k, shift) for k, shift in enumerate(own))
    together = shifts.left_out([everyone])
    if together <= alone:
        return None
    tree = linkage(np.array(own) * shifts.spread, "ward")
    for count, least in _EXPLAINED.items():
        labels = fcluster(tree, count, "maxclust")
        groups = sorted(([k for k in everyone if labels[k] == g] for g in set(labels)), key=lambda g: (-len(g), g))
        if min(len(g) for g in groups) < _LEAST_OF_GROUP:
            continue
        explained = (together - shifts.left_out(groups)) / (together - alone)
        if explained >= least:
            found = np.array([shifts.shared(g) for g in groups])
            names = tuple(UNITS)[: found.shape[1]]
            found[:, 2:] *= shifts.spread[2:]
            sizes = dict(zip(names, np.ptp(found, axis=0).tolist(), strict=True))
            return Configuration(tuple(tuple(runs[k].name for k in g) for g in groups), sizes, float(explained))
    return None


def _shifts(hypothesis: Hypothesis, runs: Sequence[Run]) -> _Shifts:
    """Offset at the mean angle of all trials, gain and width of each trial, width always where the core has one."""
    problem, q = hypothesis.problem, hypothesis.q
    terms = replace(problem.terms, shift=True, own_offset=False, frequency_hz=0.0, width=problem.baseline.width)
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
