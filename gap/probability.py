"""How sure: from the signs of a selection to probabilities, calibrated on development cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

# Ridge logistic regression on 141 names that the diagnosis gave on development seeds 104 and 105; frozen.
_BIAS, _GENERIC, _SEVERAL, _AMBIGUOUS, _LEFT, _SHARE = 2.1, -1.0, -0.75, -0.7, -0.6, 1.3
# Effects that bend to almost anything: a name of theirs is worth less.
GENERIC = frozenset({"asymmetry", "nonlinear_gain", "trial_shift"})


_UNTRIED = -2.0  # a judgement, not a fit: below 0.8 whatever else


def probability(name: str, share: float, several: bool, ambiguous: bool, left: float, untried: bool = False) -> float:
    """Probability that a chosen effect is there.

    logit P = b_0 + b_1 generic + b_2 several + b_3 ambiguous + b_4 max(ln left, 0) + b_5 share

    Args:
        name: of the effect; whether it is one that bends to almost anything.
        share: of the structural gap that it closes, 0 to 1.
        several: whether other effects were chosen, too.
        ambiguous: whether anything could stand in its place.
        left: RMSE that all causes together leave, by what noise and the simulator's own form leave.
        untried: whether the library lacks an effect that this one is easily taken for.
    """
    logit = _BIAS + _GENERIC * (name in GENERIC) + _SEVERAL * several + _AMBIGUOUS * ambiguous
    logit += _UNTRIED * untried + _LEFT * math.log(max(left, 1.0)) + _SHARE * min(max(share, 0.0), 1.0)
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
