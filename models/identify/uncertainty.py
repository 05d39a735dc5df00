"""Identified parameters with their confidence intervals, and those that the data do not determine."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from hystmpc.trials.types import Vec

from ..chain import Chain
from ..effects.catalogue import EFFECTS
from ..effects.effect import Candidate, base_name, unit_on
from .cross_validation import Hypothesis
from .problem import Problem
from .runs import Run

_BLOCKS_S = (3.0, 6.0, 12.0)
_AT_BOUND = 1e-3  # share of the unknowns' typical changes
_TOLERANCE = 1e-8  # share of the greatest eigenvalue; smaller ones carry no information
_FLAT_LOG, _FLAT_RANGE = float(np.log(3.0)), 0.25  # half interval: factor; share of the range


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of the unknowns of a fit.

    Attributes:
        covariance: of the unknowns q (Q, Q); zero for those at a bound.
        quantile: of Student's t, 95 %, by which a standard error becomes half an interval of 90 %.
        flat: unknowns that the errors do not determine (Q,).
        at_bound: unknowns that ended at an edge of their range (Q,).
    """

    covariance: Vec
    quantile: float
    flat: NDArray[np.bool_]
    at_bound: NDArray[np.bool_]

    def half_width(self, slope: Vec) -> float:
        """Half the interval of 90 % of a quantity with derivative `slope` (Q,) by the unknowns."""
        return self.quantile * float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))


def uncertainty(problem: Problem, q: Vec, runs: Sequence[Run]) -> Uncertainty:
    """Gauss-Newton covariance with the spread of block sums (sandwich).

    C = H^+ (sum_b g_b g_b^T) H^+ B / (B - Q),  H = J^T J,  g_b = J_b^T e_b

    over blocks b of time, whose errors may be correlated within; of blocks of 3, 6 and 12 s those with the largest
    variance count. Unknowns at a bound are held there.

    Source: Liang, Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73 (1986), eq. (8).
    """
    pairs = [problem.error(q, run) for run in runs]
    at_bound = np.minimum(np.abs(q - problem.lower), np.abs(q - problem.upper)) < _AT_BOUND
    free = np.flatnonzero(~at_bound)
    hessian = sum((j[:, free].T @ j[:, free] for _, j in pairs), np.zeros((free.size, free.size)))
    inverse, lost = _inverse(hessian)
    best, quantile = np.zeros_like(hessian), float(stdtrit(1, 0.95))
    for seconds in _BLOCKS_S:
        scores = np.array(
            [g for (e, j), run in zip(pairs, runs, strict=True) for g in _scores(e, j[:, free], run, seconds)]
        )
        spare = len(scores) - free.size
        if spare < 1 or (spare < 2 * free.size and best.any()):
            break
        spread = inverse @ (scores.T @ scores) @ inverse * len(scores) / spare
        if np.trace(spread) > np.trace(best):
            best, quantile = spread, float(stdtrit(spare, 0.95))
    covariance = np.zeros((q.size, q.size))
    covariance[free[:, None], free[None, :]] = best
    flat = _flat(problem, quantile * np.sqrt(np.diag(covariance)))
    flat[free[lost]] = True
    return Uncertainty(covariance, quantile, flat & ~at_bound, at_bound)


def _inverse(hessian: Vec) -> tuple[Vec, NDArray[np.bool_]]:
    """Pseudo-inverse (Q, Q), and the unknowns that it leaves out (Q,)."""
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    weights, turn = np.linalg.eigh(hessian / np.outer(size, size))
    seen = weights > _TOLERANCE * max(float(weights.max(initial=0.0)), 1e-300)
    inverse = (turn[:, seen] / weights[seen]) @ turn[:, seen].T / np.outer(size, size)
    lost = (turn[:, ~seen] ** 2).sum(axis=1) > 0.5
    return inverse, lost | (size <= 1e-140)


def _scores(error: Vec, by_q: Vec, run: Run, seconds: float) -> list[Vec]:
    """Derivative of half the squared error of each block (Q,)."""
    blocks = run.blocks(seconds)
    return [by_q[blocks == b].T @ error[blocks == b] for b in np.unique(blocks)]


def _flat(problem: Problem, half: Vec) -> NDArray[np.bool_]:
    """Unknowns whose interval is as wide as a factor of three either side, or half of their range."""
    logarithmic = np.zeros(problem.size, dtype=np.bool_)
    scales = [freedom.scale for c in problem.effects for freedom in c.free]
    if scales:
        logarithmic[-len(scales) :] = np.array(scales) == 0
    return np.where(logarithmic, half > _FLAT_LOG, half > _FLAT_RANGE * (problem.upper - problem.lower))


@dataclass(frozen=True)
class ParameterRow:
    """Identified number of the corrected simulator.

    Attributes:
        value, ci90: identified value and its 90 % interval, not-a-number where unknown.
        neutral: value at which it has no effect; None for a baseline quantity.
        at_bound: whether it ended at an edge of its range.
        flat: whether the logs do not determine it.
        unit: with `cmd` for the unit of the command; 1 for a plain number.
    """

    owner: str
    name: str
    value: float
    ci90: Interval
    neutral: float | None = None
    at_bound: bool = False
    flat: bool = False
    unit: str = "1"

    def times(self, factor: float) -> ParameterRow:
        """Number converted to a unit of which the present one has `factor`."""
        low, high = self.ci90
        neutral = None if self.neutral is None else self.neutral * factor
        return replace(self, value=self.value * factor, ci90=(low * factor, high * factor), neutral=neutral)


Interval = tuple[float, float]


UNKNOWN: Interval = (float("nan"), float("nan"))

_NUDGE = 1e-3
_OF_PLAYS = re.compile(r"a\d+|alpha|r\d+")  # weights, spacing of half-widths, half-widths
BASELINE_UNITS = {
    "gain": "deg/cmd",
    "offset": "deg",
    "backlash_width": "cmd",
    "stiffness": "deg/cmd",
    "friction": "deg",
}
"""Unit of each quantity of a baseline."""

_ENDINGS = {"_deg_s": "deg/s", "_deg": "deg", "_hz": "Hz", "_s": "s"}  # longest first


def parameter_rows(
    hypothesis: Hypothesis, runs: Sequence[Run], estimated: Mapping[str, Mapping[str, float]]
) -> tuple[ParameterRow, ...]:
    """All numbers of the corrected simulator: of the baseline, of operators, and those estimated separately.

    Args:
        estimated: parameters by effect and name; those outside the fit are listed without interval.
    """
    uncertain = uncertainty(hypothesis.problem, hypothesis.q, runs)
    rows = [*_baseline_rows(hypothesis, uncertain), *_effect_rows(hypothesis, uncertain)]
    known = {(row.owner, row.name) for row in rows}
    rows += [
        ParameterRow(effect, name, value, UNKNOWN, _neutral(effect, name), unit=_unit_of_name(name))
        for effect, parameters in estimated.items()
        for name, value in parameters.items()
        if (effect, name) not in known
    ]
    return tuple(rows)


def core_rows(hypothesis: Hypothesis, runs: Sequence[Run]) -> tuple[ParameterRow, ...]:
    """Fitted weights and widths of the core's plays; `neutral` is the value before retuning."""
    problem, q = hypothesis.problem, hypothesis.q
    baseline, z = problem.baseline, problem.retuned(hypothesis.q)
    names = [p.name for p in baseline.chain.core.parameters]
    held = {*baseline.held, *(k for indices in baseline.effects.values() for k in indices.values())}
    plays = [k for k, name in enumerate(names) if _OF_PLAYS.fullmatch(name) and k not in held]
    if z.size < len(names) or not plays:  # no parameters of the core itself
        return ()
    uncertain, rows = uncertainty(problem, q, runs), []
    for k in plays:
        half = uncertain.half_width(_slope(_entry(problem, k), q))
        ends, bound = (float(z[k] - half), float(z[k] + half)), half == 0.0
        nominal, unit = float(baseline.nominal[k]), baseline.chain.core.parameters[k].unit
        rows.append(ParameterRow("core", names[k], float(z[k]), UNKNOWN if bound else ends, nominal, bound, unit=unit))
    return tuple(rows)


def _effect_rows(hypothesis: Hypothesis, uncertain: Uncertainty) -> Iterator[ParameterRow]:
    problem, q = hypothesis.problem, hypothesis.q
    values, z = problem.plain(q), problem.retuned(q)
    k = problem.size - sum(len(c.free) for c in problem.effects)
    for c in problem.effects:
        for freedom in c.free:
            half = uncertain.half_width(np.eye(q.size)[k])
            ends = _ends(values[k], half, freedom.scale, (freedom.lower, freedom.upper))
            neutral = _neutral(c.effect, freedom.name) if c.depends is None else 0.0
            at_bound, flat = bool(uncertain.at_bound[k]), bool(uncertain.flat[k])
            yield ParameterRow(
                c.effect,
                freedom.name,
                float(values[k]),
                UNKNOWN if at_bound else ends,
                neutral,
                at_bound,
                flat,
                _unit(c, freedom.name, problem.chain),
            )
            k += 1
        in_core = {} if c.operators else problem.baseline.effects.get(c.effect, {})
        for name, at in in_core.items():
            half, value = uncertain.half_width(_slope(_entry(problem, at), q)), float(z[at])
            ends, nominal = (value - half, value + half), float(problem.baseline.nominal[at])
            unit = next((p.unit for p in problem.baseline.chain.core.parameters if p.name == name), "1")
            yield ParameterRow(c.effect, name, value, ends, nominal, unit=unit)


def _baseline_rows(hypothesis: Hypothesis, uncertain: Uncertainty) -> Iterator[ParameterRow]:
    problem, q = hypothesis.problem, hypothesis.q
    for name, value in problem.baseline.quantities(problem.retuned(q)).items():
        half = uncertain.half_width(_slope(_quantity(problem, name), q))
        flat = half > _FLAT_RANGE * _reach(problem, name, q)
        yield ParameterRow("baseline", name, value, (value - half, value + half), flat=flat, unit=BASELINE_UNITS[name])


def _reach(problem: Problem, name: str, q: Vec) -> float:
    """Range of a baseline quantity while each unknown in turn passes through its bounds."""
    quantity, reached = _quantity(problem, name), []
    for k in range(problem.size - sum(len(c.free) for c in problem.effects)):
        reached += [
            quantity(np.concatenate([q[:k], [end], q[k + 1 :]])) for end in (problem.lower[k], problem.upper[k])
        ]
    return float(np.ptp(reached)) if reached else 0.0


def _unit(candidate: Candidate, name: str, chain: Chain) -> str:
    if candidate.depends is not None:
        return next((p.unit for p in chain.parameters if p.name == name), "1")
    for operator in candidate.operators:
        for parameter in operator.parameters:
            if parameter.name == name:
                return unit_on(parameter.unit, candidate.side)
    return "1"


def _unit_of_name(name: str) -> str:
    return next((unit for ending, unit in _ENDINGS.items() if name.endswith(ending)), "1")


def _entry(problem: Problem, at: int) -> Callable[[Vec], float]:
    return lambda q: float(problem.retuned(q)[at])


def _quantity(problem: Problem, name: str) -> Callable[[Vec], float]:
    return lambda q: problem.baseline.quantities(problem.retuned(q))[name]


def _ends(value: float, half: float, scale: float, bounds: Interval) -> Interval:
    if scale:
        low, high = value - half * scale, value + half * scale
    else:
        half = min(half, 50.0)
        low, high = value * np.exp(-half), value * np.exp(half)
    return float(max(low, bounds[0])), float(min(high, bounds[1]))


def _slope(quantity: Callable[[Vec], float], q: Vec) -> Vec:
    """Derivative (Q,) of a quantity by central differences."""
    moves = _NUDGE * np.eye(q.size)
    return np.array([(quantity(q + row) - quantity(q - row)) / (2 * _NUDGE) for row in moves])


def _neutral(effect: str, parameter: str) -> float | None:
    known = EFFECTS.get(effect)
    return None if known is None else known.neutral.get(parameter, known.neutral.get(base_name(parameter)))
