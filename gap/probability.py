"""How sure: from the signs of a selection to probabilities, calibrated on development cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from .hypothesis import gain
from .select import Selection

# Weights of the signs, fitted by logistic regression on development cases (docs/diagnosis.md) and frozen.
_BIAS, _INCLUSION, _CLEAR, _CLOSED = -2.0, 2.5, 1.0, 1.5


def probability(inclusion: float, clear: float, closed: float) -> float:
    """Probability that a chosen effect is there.

    logit P = b_0 + b_1 inclusion + b_2 clear + b_3 closed

    Args:
        inclusion: share of resamples in which it was chosen.
        clear: margin to the best other effect in its place, as a share of what it closes, 0 to 1.
        closed: share of the structural gap that all causes close together, 0 to 1.
    """
    logit = _BIAS + _INCLUSION * inclusion + _CLEAR * min(max(clear, 0.0), 1.0) + _CLOSED * min(max(closed, 0.0), 1.0)
    return 1 / (1 + math.exp(-logit))


def margins(selection: Selection, floor_mse: float) -> dict[str, float]:
    """Of each chosen effect the margin to the best other in its place, as a share of what the effect does."""
    chosen, found = selection.chosen, {}
    names = chosen.hypothesis.effects
    for effect in names:
        rest = names - {effect}
        without = selection.tried.get(rest, selection.baseline)
        does = max(without.mse - max(chosen.mse, floor_mse), 1e-12)
        others = [
            gain(judged, chosen)[0]
            for tried, judged in selection.tried.items()
            if len(tried) == len(names) and rest < tried and tried != names
        ]
        found[effect] = max(min(min(others, default=does) / does, 1.0), 0.0)
    return found


def ranking(
    chosen: Mapping[str, float], inclusion: Mapping[str, float], library: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    """Every effect of the library with its probability; those not chosen share what is left by their inclusion."""
    left = 1 - max(chosen.values(), default=0.0)
    rows = [(name, chosen.get(name, left * min(inclusion.get(name, 0.0), 1.0))) for name in library]
    return tuple(sorted(rows, key=lambda row: -row[1]))
