"""Identified numbers with their intervals, and which of them the logs do not determine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.effect import base_name
from hystmpc.trials.types import Vec

from .diagnosis import FoundEffect, Interval
from .hypothesis import Hypothesis
from .problem import Problem
from .recording import Run
from .uncertainty import Uncertainty, uncertainty

UNKNOWN: Interval = (float("nan"), float("nan"))

_NUDGE = 1e-3


def parameter_rows(
    hypothesis: Hypothesis, runs: Sequence[Run], effects: Sequence[FoundEffect]
) -> tuple[ParameterRow, ...]:
    """Every number of the corrected simulator: the baseline's, those of operators, those estimated beside the fit.

    Args:
        hypothesis: the corrected simulator, at its optimum.
        runs: what it was fitted on.
        effects: found ones; parameters that are no unknown of the fit are taken from them, without interval.
    """
    found = uncertainty(hypothesis.problem, hypothesis.q, runs)
    rows = [*_baseline_rows(hypothesis, found), *_effect_rows(hypothesis, found)]
    known = {(row.owner, row.name) for row in rows}
    rows += [
        ParameterRow(effect.name, name, value, UNKNOWN, _neutral(effect.name, name))
        for effect in effects
        for name, value in effect.parameters.items()
        if (effect.name, name) not in known
    ]
    return tuple(rows)


def _effect_rows(hypothesis: Hypothesis, found: Uncertainty) -> Iterator[ParameterRow]:
    problem, q = hypothesis.problem, hypothesis.q
    values, z = problem.plain(q), problem.retuned(q)
    k = problem.size - sum(len(c.free) for c in problem.effects)
    for c in problem.effects:
        for freedom in c.free:
            half = found.half_width(np.eye(q.size)[k])
            ends = _ends(values[k], half, freedom.scale, (freedom.lower, freedom.upper))
            neutral = _neutral(c.effect, freedom.name)
            at_bound, flat = bool(found.at_bound[k]), bool(found.flat[k])
            yield ParameterRow(
                c.effect, freedom.name, float(values[k]), UNKNOWN if at_bound else ends, neutral, at_bound, flat
            )
            k += 1
        in_core = {} if c.operators else problem.baseline.effects.get(c.effect, {})
        for name, at in in_core.items():
            half, value = found.half_width(_slope(_entry(problem, at), q)), float(z[at])
            yield ParameterRow(c.effect, name, value, (value - half, value + half), float(problem.baseline.nominal[at]))


def _baseline_rows(hypothesis: Hypothesis, found: Uncertainty) -> Iterator[ParameterRow]:
    problem, q = hypothesis.problem, hypothesis.q
    for name, value in problem.baseline.quantities(problem.retuned(q)).items():
        half = found.half_width(_slope(_quantity(problem, name), q))
        yield ParameterRow("baseline", name, value, (value - half, value + half))


def _entry(problem: Problem, at: int) -> Callable[[Vec], float]:
    """One number of the baseline's freedom by the unknowns."""
    return lambda q: float(problem.retuned(q)[at])


def _quantity(problem: Problem, name: str) -> Callable[[Vec], float]:
    """One quantity of the baseline by the unknowns."""
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
    """Value at which an effect does nothing; None for a parameter that does not matter then."""
    known = EFFECTS.get(effect)
    return None if known is None else known.neutral.get(parameter, known.neutral.get(base_name(parameter)))


@dataclass(frozen=True)
class ParameterRow:
    """One identified number of the corrected simulator.

    Attributes:
        owner: effect, or `baseline`.
        name: with its unit, as `tau_s`.
        value, ci90: identified value and its 90 % interval, not-a-number where unknown.
        neutral: value at which it does nothing; None for a baseline quantity.
        at_bound: whether it ended at an edge of its range.
        flat: whether the logs do not determine it.
    """

    owner: str
    name: str
    value: float
    ci90: Interval
    neutral: float | None = None
    at_bound: bool = False
    flat: bool = False
