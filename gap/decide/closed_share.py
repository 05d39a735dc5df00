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
        """What each cause closes, and its 90 % interval.

        A cause is weighed by the error that comes back without it, the others fitted anew:

            share_i = closed (E_without_i - E) / sum_j max(E_without_j - E, 0)

        The shares add up to what all close together, where each of them lowers the error. Of causes that can replace
        each other none closes anything. The interval is that of the fall, blocks resampled together before and after:
        a small cause beside a large one is as sure as its own fall.

        Args:
            names: of the causes.
            blocks: errors with all of them, with all but one, and with none.
        """
        after = blocks(names)
        without = {name: blocks(names - {name}) for name in sorted(names)}
        falls = sum(max(b.mse - after.mse, 0.0) for b in without.values())
        together = max(self.closed(after.mse), 0.0)
        found = {}
        for name, before in without.items():
            fall = before.mse - after.mse
            share = together * fall / falls if falls > 0 else 0.0
            one = self.closed(self.before.mse - fall)
            scale = share / one if one else 0.0
            low, high = closed_interval(self.before, before, after, self.floor_mse, self.seed)
            found[name] = share, self._widened(share, (scale * low, scale * high))
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
