"""Mann-Whitney U test of the errors of two models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import mannwhitneyu

from hystmpc.trials.types import Vec

Unit = Literal["points", "scans"]


@dataclass(frozen=True)
class RankTest:
    """Two-sided Mann-Whitney U test in one pattern. Source: S1 section III-B, p < .01 in every pattern.

    Attributes:
        pattern: name of the pattern.
        first, second: names of the models.
        unit: what is counted. `points` as S1 does; points of one scan follow each other in time, so they are not
            independent and this p is too small. `scans` takes the mean error of a scan as one observation.
        n: observations of each model.
        u: pairs in which the first model's error is the greater one, ties counted by half.
        p: of the null hypothesis that neither model tends to the greater errors.
    """

    pattern: str
    first: str
    second: str
    unit: Unit
    n: int
    u: float
    p: float

    @property
    def probability_smaller(self) -> float:
        """Share of pairs in which the first model's error is the smaller one, 0 to 1: the size of the effect."""
        return 1.0 - self.u / self.n**2


def rank_test(names: tuple[str, str], errors_mm: tuple[Vec, Vec], pattern: str, unit: Unit) -> RankTest:
    """The test on two samples of one size; p = 1 where all values are equal, which has no ranks to compare."""
    first, second = errors_mm
    if np.ptp(np.concatenate([first, second])) == 0:
        return RankTest(pattern, *names, unit, first.size, first.size**2 / 2, 1.0)
    found = mannwhitneyu(first, second, alternative="two-sided")
    return RankTest(pattern, *names, unit, first.size, float(found.statistic), float(found.pvalue))
