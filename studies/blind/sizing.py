"""Sizes of withheld effects, so that the gap which they leave after retuning is a wanted number of floors."""

from __future__ import annotations

import math
from collections.abc import Callable

from .generator import Withheld

_TOLERANCE = 0.055
_TRIES = 9
_STEP = 6.0  # greatest change of size at once


def sized(effect: Withheld, wanted_deg: float, gap: Callable[[Withheld], float]) -> tuple[Withheld, float]:
    """Search the size at which `gap` is `wanted_deg`, by secants in the logarithms of size and gap.

    Args:
        effect: its size is where the search starts.
        wanted_deg: gap to reach [deg].
        gap: of an effect [deg]; about rising with the size.

    Returns:
        The best effect found, at most of its greatest size, and its gap [deg].
    """
    size, power = min(effect.size, effect.generator.greatest), 1.0
    best: tuple[float, Withheld, float] | None = None
    before: tuple[float, float] | None = None
    for _ in range(_TRIES):
        found = max(gap(effect.resized(size)), 1e-9)
        miss = abs(found / wanted_deg - 1)
        if best is None or miss < best[0]:
            best = miss, effect.resized(size), found
        if miss < _TOLERANCE or (found < wanted_deg and size >= effect.generator.greatest):
            break
        power = _power(before, (size, found), power)
        before = size, found
        step = min(max((wanted_deg / found) ** (1 / power), 1 / _STEP), _STEP)
        size = min(size * step, effect.generator.greatest)
    assert best is not None  # the loop runs at least once
    return best[1], best[2]


def _power(before: tuple[float, float] | None, now: tuple[float, float], power: float) -> float:
    """Exponent of gap over size between two tries, kept within what a smooth effect can have."""
    if before is None or abs(math.log(now[0] / before[0])) < 1e-3:
        return power
    return min(max(math.log(now[1] / before[1]) / math.log(now[0] / before[0]), 0.4), 4.0)
