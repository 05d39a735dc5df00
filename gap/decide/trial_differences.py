"""Differences between trials: groups that share offset, gain and width, or a measured input that these follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Mat, Vec

from ..diagnosis import InputDependence

NAME = "configuration_change"
SHIFT = "trial_shift"
UNITS = {"offset_deg": "deg", "gain_share": "1", "width_deg": "deg"}
_LEAST_OF_GROUP = 2
# Least share, on held-out trials, explained by shifts of 2 or 3 groups of that explained by shifts of each trial.
_EXPLAINED = {2: 0.87, 3: 0.95}
_RIDGE = 1e-9
# The same least share for shifts that follow a measured input, and the part of it from which a slope is given.
_FOLLOWED, _SLOPE = 0.87, 0.05


@dataclass(frozen=True)
class Configuration:
    """Groups of trials that share offset, gain and width.

    Attributes:
        groups: names of the trials of each group, the largest group first.
        sizes: greatest difference between groups: `offset_deg` [deg at the mean angle], `gain_share` of the gain and,
            if the core has a width, `width_deg` [deg, as change of the angle].
    """

    groups: tuple[tuple[str, ...], ...]
    sizes: dict[str, float]


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
        """Least-squares coefficients (K,) common to some trials."""
        square = self.square[runs].sum(axis=0)
        ridge = _RIDGE * np.trace(square) * np.eye(len(square))
        return np.asarray(np.linalg.solve(square + ridge, self.product[runs].sum(axis=0)), dtype=np.float64)

    def left(self, run: int, shift: Vec) -> float:
        """Sum of squared errors of a trial after correction by a shift."""
        return float(self.energy[run] - 2 * shift @ self.product[run] + shift @ self.square[run] @ shift)

    def left_out(self, groups: Sequence[Sequence[int]]) -> float:
        """Leave-one-out sum of squared errors, each trial with the shift of the other trials of its group."""
        return sum(self.left(r, self.shared([k for k in group if k != r])) for group in groups for r in group)

    def following(self, z: Vec, runs: Sequence[int], terms: Sequence[int]) -> tuple[Vec, Vec]:
        """Coefficients (K,) common to some trials, and slopes (K,) over z (R,) of some terms; the others have none."""
        size, kept = len(self.spread), [*range(len(self.spread)), *(len(self.spread) + k for k in terms)]
        factors = [np.array([[1.0, z[r]], [z[r], z[r] ** 2]]) for r in runs]
        square = sum(np.kron(f, self.square[r]) for f, r in zip(factors, runs, strict=True))
        product = sum(np.kron(f[0], self.product[r]) for f, r in zip(factors, runs, strict=True))
        square = np.asarray(square)[np.ix_(kept, kept)]
        ridge = _RIDGE * np.trace(square) * np.eye(len(kept))
        both = np.zeros(2 * size)
        both[kept] = np.linalg.solve(square + ridge, np.asarray(product)[kept])
        return both[:size], both[size:]

    def followed(self, z: Vec, terms: Sequence[int]) -> float:
        """Leave-one-out sum of squared errors, each trial with the line over z (R,) through the other trials."""
        total = 0.0
        for r in range(len(z)):
            level, slope = self.following(z, [k for k in range(len(z)) if k != r], terms)
            total += self.left(r, level + slope * z[r])
        return total


def configuration_of(hypothesis: Hypothesis, runs: Sequence[Run]) -> Configuration | None:
    """Groups of trials that explain shifts between trials; None if these scatter, or no effect shifts them.

        share = (E_all - E_groups) / (E_all - E_own)

    with the squared errors of one shift for all other trials, of the groups', and of each trial's own. The fewest
    groups, of two trials or more, that reach 0.87 (0.95 for three groups) count. Groups are joined by Ward's method (J.
    Am. Stat. Assoc. 58, 1963) on the angle changes by offset, gain and width of each trial.
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
            return Configuration(tuple(tuple(runs[k].name for k in g) for g in groups), sizes)
    return None


def _shifts(hypothesis: Hypothesis, runs: Sequence[Run]) -> _Shifts:
    """Normal equations for offset at the mean angle, gain and, if the core has one, width of each trial."""
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


def differences_explained(hypothesis: Hypothesis, runs: Sequence[Run]) -> bool:
    """Whether what differs between trials has a cause: groups of trials, or a measured input."""
    return configuration_of(hypothesis, runs) is not None or bool(dependences_of(hypothesis, runs))


def dependences_of(hypothesis: Hypothesis, runs: Sequence[Run]) -> tuple[InputDependence, ...]:
    """Slopes of what differs between trials over the measured input that explains it; empty where none does.

        shift_r = a + b z_r,    share = (E_all - E_line) / (E_all - E_own)

    z_r is the mean of the input in trial r. The squared errors are those of `configuration_of`, E_line with the line
    through the other trials. The input with the largest share counts, from 0.87. A term gets a slope if the share
    falls by 0.05 without it. Slopes are per unit of the input, in working units.
    """
    names = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)] if runs else []
    if SHIFT not in hypothesis.effects or len(runs) < 2 * _LEAST_OF_GROUP or not names:
        return ()
    shifts, everyone = _shifts(hypothesis, runs), list(range(len(runs)))
    alone = sum(shifts.left(k, shifts.shared([k])) for k in everyone)
    together = shifts.left_out([everyone])
    if together <= alone:
        return ()
    best = max((_followed(shifts, _mean_inputs(runs, name), together, alone, name) for name in names), key=_share)
    return best if _share(best) >= _FOLLOWED else ()


def _followed(shifts: _Shifts, z: Vec, together: float, alone: float, name: str) -> tuple[InputDependence, ...]:
    """Dependence on one input with the fewest slopes; empty where it does not vary."""
    wide = float(np.ptp(z))
    if not wide:
        return ()
    level = (z - z.mean()) / wide
    terms = list(range(len(shifts.spread)))

    def share(kept: Sequence[int]) -> float:
        return (together - shifts.followed(level, kept)) / (together - alone)

    whole = share(terms)
    for k in sorted(terms, key=lambda k: -share([j for j in terms if j != k])):
        fewer = [j for j in terms if j != k]
        if fewer and share(fewer) >= whole - _SLOPE:
            terms = fewer
    slopes = -shifts.following(level, range(len(z)), terms)[1] / wide  # the errors are simulated less measured
    slopes[2:] *= shifts.spread[2:]
    explained = share(terms)
    return tuple(InputDependence(name, tuple(UNITS)[k], float(slopes[k]), explained) for k in terms)


def _share(dependences: Sequence[InputDependence]) -> float:
    return dependences[0].share if dependences else 0.0


def _mean_inputs(runs: Sequence[Run], name: str) -> Vec:
    return np.array([float(np.mean(run.inputs[name])) for run in runs])
