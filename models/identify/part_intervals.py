"""Numbers of the parts of an identified device: intervals that hold the choice of the form, and which say nothing."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.trials.types import Vec

from ..contract.metadata import Range
from ..effects.effect import Candidate, Freedom
from .auto_search import AutoSettings, Choice
from .cross_validation import Hypothesis, gain
from .parts import whole_delay
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
    k: `AutoSettings.widening`. Of a number at the end of what was searched the interval is open there.

    Source: Buckland, Burnham, Augustin, Model selection: an integral part of inference, Biometrics 53 (1997), eq. (3).
    """
    rows = [r for r in parameter_rows(choice.hypothesis, runs, {}) if r.owner != "baseline"]
    folds = [_numbers(choice.hypothesis, q) for q in choice.judged.fold_q]
    equals = [other for other in tried if _as_good(gain(other.judged, choice.judged), choice, settings)]
    for row, (candidate, freedom) in zip(rows, _free(choice), strict=True):
        key, logarithmic = (candidate.label, freedom.name), freedom.scale == 0
        change = _log if logarithmic else _same
        value = change(row.value)
        ends = [abs(change(end) - value) for end in row.ci90 if math.isfinite(end)]
        sigma = max(ends, default=0.0) / _QUANTILE
        left = np.array([change(fold[key]) for fold in folds])
        jackknife = math.sqrt((left.size - 1) / max(left.size, 1) * float(np.sum((left - left.mean()) ** 2)))
        alike = [_numbers(o.hypothesis, o.hypothesis.q) for o in equals if candidate.label in _labels(o)]
        away = [change(other[key]) - value for other in alike]
        spread = math.sqrt(float(np.mean(np.square(away)))) if away else 0.0
        half = settings.widening * _QUANTILE * math.hypot(sigma, jackknife, spread)
        low, high = value - half, value + half
        if logarithmic:
            low, high = math.exp(max(low, -50.0)), math.exp(min(high, 50.0))
        if _at_lower(row, freedom):  # what is beyond was not looked at
            low = 0.0 if freedom.lower >= 0 else -math.inf
        elif row.at_bound:
            high = math.inf
        more = sum(map(whole_delay, choice.forms.values())) if candidate.effect == "delay" else 0.0
        yield replace(row, value=row.value + more, ci90=(low + more, high + more))


def _free(choice: Choice) -> list[tuple[Candidate, Freedom]]:
    """The free numbers of a device's effects in the order of the rows."""
    return [(c, freedom) for c in choice.hypothesis.problem.effects for freedom in c.free]


def _labels(choice: Choice) -> set[str]:
    return {c.label for c in choice.hypothesis.problem.effects}


def moved_row(row: ParameterRow, value: float, choice: Choice) -> ParameterRow:
    """A number with its value from a fit at another rate, the interval as wide as it was.

    A lag between samples that are held is half a sample early: at another rate the delay is another one.
    """
    low, high = row.ci90
    effects = choice.hypothesis.problem.effects
    if any((c.effect, f.name) == (row.owner, row.name) and f.scale == 0 for c in effects for f in c.free):
        return replace(row, value=value, ci90=(value * low / row.value, value * high / row.value))
    return replace(row, value=value, ci90=(value + low - row.value, value + high - row.value))


_NEARLY = 2.0  # times its lower bound: a lag down to there is none
_EDGE = 0.01  # of the command's range: a slack so near its lowest value is an offset


def without_meaning(
    choice: Choice,
    parameters: Sequence[ParameterRow],
    command: Range,
    needed: Collection[tuple[str, str]] = (),
) -> tuple[str, str] | None:
    """A part and its effect that may do nothing, as far as its intervals tell; None where there is none.

    Of an effect with a neutral value that is where the intervals of all such numbers hold it; of several terms of creep
    one is enough. A lag does nothing within twice its lower bound, far less than a sample, a top speed where it may be
    that of the fastest command, a slack where it may end below the lowest command, and a creep as quick as creep may be
    is a lag. The curve of a core goes with the part `core`.

    Args:
        choice: the device.
        parameters: its rows, in order.
        command: range of the command in the trials.
        needed: parts and effects that are not asked, see `AutoSettings.needed`.
    """
    rows = iter(parameters)
    owners = [(name, c) for name, form in choice.forms.items() for c in form]
    for name, candidate in [*owners, *(("core", c) for c in choice.core.curve)]:
        numbers = [(next(rows), freedom) for freedom in candidate.free]
        if (name, candidate.effect) not in needed and _may_do_nothing(numbers, command):
            return name, candidate.effect
    return None


def _may_do_nothing(numbers: Sequence[tuple[ParameterRow, Freedom]], command: Range) -> bool:
    neutral: list[bool] = []
    for row, freedom in numbers:
        low, high = row.ci90
        if row.owner == "lag":
            none = low < _NEARLY * freedom.lower if row.name.startswith("tau") else False
            none |= row.name == "top_speed" and high >= freedom.upper
        elif row.owner == "slack":
            none = row.name == "slack" and low <= command.lower + _EDGE * (command.upper - command.lower)
        elif row.owner == "delay":
            none = low <= 0.0
        elif row.owner == "creep":
            none = low <= 0.0 <= high if row.name.startswith("share") else _at_lower(row, freedom)
        else:
            if row.neutral is not None:
                neutral.append(low <= row.neutral <= high)
            continue
        if none:
            return True
    return bool(neutral) and all(neutral)


def _at_lower(row: ParameterRow, freedom: Freedom) -> bool:
    return row.at_bound and row.value - freedom.lower < freedom.upper - row.value


def _log(value: float) -> float:
    return math.log(max(value, 1e-9))


def _same(value: float) -> float:
    return value


def _numbers(hypothesis: Hypothesis, q: Vec) -> dict[tuple[str, str], float]:
    values = hypothesis.problem.effect_values(q)
    pairs = zip(hypothesis.problem.effects, values, strict=True)
    return {(c.label, name): value for c, values in pairs for name, value in values.items()}


def _as_good(gained: tuple[float, float], choice: Choice, settings: AutoSettings) -> bool:
    """Whether the chosen device is not significantly better."""
    fall, error = gained
    return fall <= max(settings.standard_errors * error, 0.02 * choice.judged.mse)
