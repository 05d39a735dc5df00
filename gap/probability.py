"""How sure: from the signs of a selection to probabilities, calibrated on development cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hystmpc.models.effects.catalogue import EFFECTS

# Ridge logistic regression on 193 names that the diagnosis gave on seeds 105, 106 and 36284719; frozen.
_BIAS, _GENERIC, _SEVERAL, _AMBIGUOUS, _SHARE = 0.95, -0.45, -0.1, -0.8, 1.35
# Effects that bend to almost anything: a name of theirs is worth less.
GENERIC = frozenset(name for name, effect in EFFECTS.items() if effect.generic)


_UNTRIED = -2.0  # a judgement, not a fit: below 0.8 whatever else


def probability(name: str, share: float, several: bool, ambiguous: bool, untried: bool = False) -> float:
    """Probability that a chosen effect is there.

    logit P = b_0 + b_1 generic + b_2 several + b_3 ambiguous + b_4 untried + b_5 share

    Args:
        name: of the effect; whether it is one that bends to almost anything.
        share: of the structural gap that it closes, 0 to 1.
        several: whether other effects were chosen, too.
        ambiguous: whether anything could stand in its place.
        untried: whether the library lacks an effect that this one is easily taken for.
    """
    logit = _BIAS + _GENERIC * (name in GENERIC) + _SEVERAL * several + _AMBIGUOUS * ambiguous
    logit += _UNTRIED * untried + _SHARE * min(max(share, 0.0), 1.0)
    return 1 / (1 + math.exp(-logit))


def ranking(
    chosen: Mapping[str, float],
    inclusion: Mapping[str, float],
    ambiguity: Sequence[Sequence[str]],
    library: Sequence[str],
) -> tuple[tuple[str, float], ...]:
    """Every effect of the library with its probability.

    What stands in the place of a chosen effect shares what that one leaves; the others have what they were included.
    """
    left = 1 - max(chosen.values(), default=0.0)
    rivals = {name for names in ambiguity for name in names[1:]}
    even = left / max(len(rivals), 1)
    rows = []
    for name in library:
        sure = chosen.get(name, even if name in rivals else 0.5 * left * min(inclusion.get(name, 0.0), 1.0))
        rows.append((name, sure))
    return tuple(sorted(rows, key=lambda row: -row[1]))
