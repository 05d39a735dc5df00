"""Paired tests between models over the same trials: Wilcoxon's signed-rank test and Holm's correction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import wilcoxon

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

LEVEL = 0.05


@dataclass(frozen=True)
class SignedRank:
    """Wilcoxon's signed-rank test of two models' errors over the same trials, row against column.

    Attributes:
        n: trials that differ; equal ones say nothing.
        p_less, p_greater: one-sided p that the row's errors are smaller, are greater.
        p_holm: two-sided, corrected by Holm for all tests of the family.
    """

    row: str
    column: str
    n: int
    p_less: float
    p_greater: float
    p: float
    p_holm: float

    @property
    def symbol(self) -> str:
        """`<` or `>` where the one-sided p is below .05, else `~`: the paper's rule, without correction."""
        if self.p_less < LEVEL:
            return "<"
        return ">" if self.p_greater < LEVEL else "~"

    @property
    def symbol_holm(self) -> str:
        """`<` or `>` where the corrected two-sided p is below .05, else `~`."""
        if self.p_holm >= LEVEL:
            return "~"
        return "<" if self.p_less < self.p_greater else ">"


def signed_rank(row: ArrayLike, column: ArrayLike) -> tuple[int, float, float, float]:
    """Number of differing trials, p(row < column), p(row > column) and two-sided p, exact without ties.

    With n differing trials the smallest one-sided exact p is 2^-n: of 6 trials 1/64, so that p < .05 needs a losing
    rank sum of at most 2.

    Raises:
        ConfigError: if lengths differ or a number is not finite.

    Source: S2 section III-D; `scipy.stats.wilcoxon`.
    """
    a, b = np.asarray(row, dtype=np.float64), np.asarray(column, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1:
        raise ConfigError(f"signed-rank test: got shapes {a.shape} and {b.shape}, expected the same (N,)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ConfigError("signed-rank test: got errors that are not finite")
    difference = (a - b)[a != b]
    if not difference.size:
        return 0, 1.0, 1.0, 1.0
    ties = np.unique(np.abs(difference)).size < difference.size
    options: Any = {"method": "approx" if ties else "exact"}
    tests: list[Any] = [wilcoxon(difference, alternative=side, **options) for side in ("less", "greater", "two-sided")]
    less, greater, both = (float(test.pvalue) for test in tests)
    return int(difference.size), less, greater, both


def holm(p: Sequence[float]) -> Vec:
    """Holm's step-down correction: of sorted p_(1) <= ... <= p_(m), p_(k) becomes max_{j<=k} min(1, (m - j + 1) p_(j)).

    Source: Holm, Scandinavian Journal of Statistics 6 (1979) 65-70.
    """
    values = np.asarray(p, dtype=np.float64)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate(np.minimum(1.0, values[order] * np.arange(values.size, 0, -1)))
    corrected = np.empty_like(stepped)
    corrected[order] = stepped
    return corrected


def pairwise(errors: Mapping[str, ArrayLike]) -> tuple[SignedRank, ...]:
    """Tests of every model against every one before it, Holm-corrected as one family.

    Args:
        errors: one figure a trial (N,) by model, all over the same trials in the same order.
    """
    names = list(errors)
    return compared(errors, [(row, column) for k, row in enumerate(names) for column in names[:k]])


def compared(errors: Mapping[str, ArrayLike], pairs: Sequence[tuple[str, str]]) -> tuple[SignedRank, ...]:
    """Tests of some pairs, row against column, Holm-corrected as one family; `errors` as for `pairwise`."""
    tests = [signed_rank(errors[row], errors[column]) for row, column in pairs]
    corrected = holm([test[3] for test in tests])
    return tuple(
        SignedRank(row, column, *test, float(p)) for (row, column), test, p in zip(pairs, tests, corrected, strict=True)
    )


def least_p(n: int) -> float:
    """Smallest one-sided exact p that n trials can give."""
    return math.ldexp(1.0, -n)
