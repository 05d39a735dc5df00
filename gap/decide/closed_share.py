"""Shares of the structural gap: closed share and its interval, and what each of several causes closes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hystmpc.models.identify.runs import Blocks
from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.types import Vec

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
        """What each cause closes beyond the larger ones, and its 90 % interval; the smallest comes first.

        The smallest of the causes is the one without which the others, fitted anew, leave the least error. Its share
        is the fall from their error to that of all. It is taken away, and the same is asked of the rest. The shares add
        up to that of all causes together. Blocks are resampled together before and after.

        Args:
            names: of the causes.
            blocks: errors with some of them.
        """
        found: dict[str, tuple[float, Interval]] = {}
        kept = names
        while kept:
            smallest = min(sorted(kept), key=lambda name: blocks(kept - {name}).mse)
            before, after = blocks(kept - {smallest}), blocks(kept)
            share = self.closed(after.mse) - self.closed(before.mse)
            found[smallest] = share, self.interval(before, after)
            kept = kept - {smallest}
        return found

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
