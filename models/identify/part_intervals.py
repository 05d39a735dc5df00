"""Numbers of the parts of an identified device: intervals that hold the choice of the form, and which say nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.trials.types import Vec

from .auto_search import AutoSettings, Choice
from .cross_validation import Hypothesis, gain
from .runs import Run
from .uncertainty import ParameterRow, parameter_rows

_QUANTILE = 1.645  # of the normal distribution, 95 %


def widened_rows(
    choice: Choice, runs: Sequence[Run], tried: Sequence[Choice], settings: AutoSettings
) -> Iterator[ParameterRow]:
    """Numbers of the parts with intervals that hold the choice of the form, too.

        half = k 1.645 sqrt(s^2 + j^2 + a^2)

    s: standard error of the fit (sandwich); j: that of a jackknife over the held-out folds; a: root mean square
    difference to alternatives with the same effect that do as well on held-out trials, such as a lag with a delay;
    k: `AutoSettings.widening`.

    Source: Buckland, Burnham, Augustin, Model selection: an integral part of inference, Biometrics 53 (1997), eq. (3).
    """
    rows = [r for r in parameter_rows(choice.hypothesis, runs, {}) if r.owner != "baseline"]
    folds = [_numbers(choice.hypothesis, q) for q in choice.judged.fold_q]
    equals = [other for other in tried if _as_good(gain(other.judged, choice.judged), choice, settings)]
    for row in rows:
        key, logarithmic = (row.owner, row.name), _is_logarithmic(choice, row)
        change = _log if logarithmic else _same
        value = change(row.value)
        ends = [abs(change(end) - value) for end in row.ci90 if math.isfinite(end)]
        own = max(ends, default=0.0) / _QUANTILE
        left = np.array([change(fold[key]) for fold in folds])
        jackknife = math.sqrt((left.size - 1) / max(left.size, 1) * float(np.sum((left - left.mean()) ** 2)))
        alike = [_numbers(o.hypothesis, o.hypothesis.q) for o in equals if _form_of(o, row) == _form_of(choice, row)]
        away = [change(other[key]) - value for other in alike]
        spread = math.sqrt(float(np.mean(np.square(away)))) if away else 0.0
        half = settings.widening * _QUANTILE * math.hypot(own, jackknife, spread)
        low, high = value - half, value + half
        if logarithmic:
            low, high = math.exp(max(low, -50.0)), math.exp(min(high, 50.0))
        yield replace(row, ci90=(low, high))


def _form_of(choice: Choice, row: ParameterRow) -> set[str]:
    """Label of the effect that a number belongs to, of the form that the device has of it."""
    every = [*choice.forms.values(), choice.core.curve]
    return {c.label for form in every for c in form if c.effect == row.owner}


def moved_row(row: ParameterRow, value: float, choice: Choice) -> ParameterRow:
    """A number with its value from a fit at another rate, the interval as wide as it was.

    A lag between samples that are held is half a sample early: at another rate the delay is another one.
    """
    low, high = row.ci90
    if _is_logarithmic(choice, row):
        return replace(row, value=value, ci90=(value * low / row.value, value * high / row.value))
    return replace(row, value=value, ci90=(value + low - row.value, value + high - row.value))


def _is_logarithmic(choice: Choice, row: ParameterRow) -> bool:
    effects = choice.hypothesis.problem.effects
    return any((c.effect, f.name) == (row.owner, row.name) and f.scale == 0 for c in effects for f in c.free)


_NEARLY = 2.0  # times its lower bound: a lag up to there is none


def without_meaning(choice: Choice, parameters: Sequence[ParameterRow]) -> tuple[str, str] | None:
    """A part and its effect of which a number may have the value at which it does nothing; None where there is none.

    That is a share of creep or a delay whose interval holds zero, or a lag within twice its lower bound, which is far
    less than a sample.
    """
    for name, form in choice.forms.items():
        for row in (row for row in parameters if row.owner in {c.effect for c in form}):
            low, high = row.ci90
            may_be_none = row.name.startswith(("share", "delay")) and low <= 0.0 <= high
            if may_be_none or (row.owner == "lag" and _nearly_none(choice, row)):
                return name, row.owner
    return None


def _nearly_none(choice: Choice, row: ParameterRow) -> bool:
    free = [f for c in choice.hypothesis.problem.effects for f in c.free if (c.effect, f.name) == (row.owner, row.name)]
    return row.name.startswith("tau") and any(row.value < _NEARLY * f.lower for f in free)


def _log(value: float) -> float:
    return math.log(max(value, 1e-9))


def _same(value: float) -> float:
    return value


def _numbers(hypothesis: Hypothesis, q: Vec) -> dict[tuple[str, str], float]:
    found = hypothesis.problem.effect_values(q)
    pairs = zip(hypothesis.problem.effects, found, strict=True)
    return {(c.effect, name): value for c, values in pairs for name, value in values.items()}


def _as_good(gained: tuple[float, float], choice: Choice, settings: AutoSettings) -> bool:
    """Whether the chosen device is not significantly better."""
    fall, error = gained
    return fall <= max(settings.standard_errors * error, 0.02 * choice.judged.mse)
