"""Shares of the structural gap: closed share and its interval, and what each of several causes closes."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hystmpc.models.identify.runs import Blocks
from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.types import Vec

T = TypeVar("T", float, Vec)

_DRAWS = 400
_LEAST_SHARE = 0.1
_LEAST_GAP = 0.1  # of the whole gap, in a resample


@dataclass(frozen=True, eq=False)
class Shares:
    """What stages of a correction close of the structural gap on some trials.

    Attributes:
        before: errors of the retuned simulator.
        floor_mse: error that stays with any simulator [deg^2].
        spread: half of a 90 % interval that is due to differences between trials, as a share of the closed share.
        seed: of the resampling.
    """

    before: Blocks
    floor_mse: float
    spread: float
    seed: int

    def closed(self, mse: float) -> float:
        """Share of the structural gap that is closed at that error."""
        return closed_share(self.before.mse, mse, self.floor_mse)

    def interval(self, before: Blocks, after: Blocks) -> Interval:
        """90 % interval of the share that lies between two stages."""
        middle = self.closed(self.before.mse - before.mse + after.mse)
        return self._widened(middle, closed_interval(self.before, before, after, self.floor_mse, self.seed))

    def of_causes(
        self, names: frozenset[str], blocks: Callable[[frozenset[str]], Blocks]
    ) -> dict[str, tuple[float, Interval]]:
        """Shapley value of each cause and its 90 % interval, blocks resampled together in every set of causes.

        Args:
            names: of the causes.
            blocks: errors with some of them.
        """
        shares = shapley(sorted(names), lambda kept: self.closed(blocks(kept).mse))
        drawn = shapley(sorted(names), functools.cache(lambda kept: self._drawn(blocks(kept))))
        return {name: (share, self._widened(share, _ends(drawn[name]))) for name, share in shares.items()}

    def _drawn(self, after: Blocks) -> Vec:
        return _drawn_shares(self.before, self.before, after, self.floor_mse, self.seed)

    def _widened(self, middle: float, ends: Interval) -> Interval:
        """An interval with the differences between trials added."""
        further = self.spread * max(abs(middle), _LEAST_SHARE)
        return middle - float(np.hypot(middle - ends[0], further)), middle + float(np.hypot(ends[1] - middle, further))


def closed_share(retuned_mse: float, with_mse: float, floor_mse: float) -> float:
    """(MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor), between -1 and 1; zero where there is no gap."""
    gap = retuned_mse - floor_mse
    return float(np.clip((retuned_mse - with_mse) / gap, -1.0, 1.0)) if gap > 0 else 0.0


def closed_interval(retuned: Blocks, before: Blocks, after: Blocks, floor_mse: float, seed: int) -> Interval:
    """90 % interval of the share that lies between two stages, blocks resampled together."""
    return _ends(_drawn_shares(retuned, before, after, floor_mse, seed))


def _drawn_shares(retuned: Blocks, before: Blocks, after: Blocks, floor_mse: float, seed: int) -> Vec:
    """The share in every resample of the blocks (D,), zeros where there is no gap.

    A resample may have less of a gap than the floor is high. Its fall then counts against a tenth of the whole gap, so
    that the sign of the fall, which is what proves a cause, is kept.
    """
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, retuned.energy.size, (_DRAWS, retuned.energy.size))
    total = retuned.samples[draws].sum(axis=1)
    gap = retuned.energy[draws].sum(axis=1) / total - floor_mse
    fall = (before.energy - after.energy)[draws].sum(axis=1) / total
    whole = retuned.mse - floor_mse
    return np.asarray(fall / np.maximum(gap, _LEAST_GAP * whole) if whole > 0 else np.zeros(_DRAWS))


def _ends(shares: Vec) -> Interval:
    low, high = np.clip(np.quantile(shares, (0.05, 0.95)), -1.0, 1.0)
    return float(low), float(high)


def shapley(names: Sequence[str], value: Callable[[frozenset[str]], T]) -> dict[str, T]:
    """Shapley value of each name for a value of sets; they add up to value(all) - value(none).

    Source: Shapley, A value for n-person games, Annals of Mathematics Studies 28 (1953).
    """
    n = len(names)
    shares: dict[str, T] = {}
    for name in names:
        others = [other for other in names if other != name]
        added = [
            math.factorial(k)
            * math.factorial(n - k - 1)
            / math.factorial(n)
            * (value(frozenset(part) | {name}) - value(frozenset(part)))
            for k in range(n)
            for part in itertools.combinations(others, k)
        ]
        shares[name] = sum(added[1:], start=added[0])
    return shares
