"""How far: what each cause closes of the gap on the final trials."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Blocks, Run, blocks_of

_DRAWS = 400


def final_blocks(hypothesis: Hypothesis, runs: Sequence[Run]) -> Blocks:
    """Errors of a fitted hypothesis on runs that it never saw."""
    return blocks_of([hypothesis.problem.held_out_error(hypothesis.q, run) for run in runs], runs)


def closed_share(retuned_mse: float, with_mse: float, floor_mse: float) -> float:
    """(MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor), between -1 and 1; zero where there is no gap."""
    gap = retuned_mse - floor_mse
    return float(np.clip((retuned_mse - with_mse) / gap, -1.0, 1.0)) if gap > 0 else 0.0


def closed_interval(retuned: Blocks, before: Blocks, after: Blocks, floor_mse: float, seed: int) -> tuple[float, float]:
    """90 % interval of the share that lies between two stages, blocks resampled together."""
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, retuned.energy.size, (_DRAWS, retuned.energy.size))
    total = retuned.samples[draws].sum(axis=1)
    gap = retuned.energy[draws].sum(axis=1) / total - floor_mse
    fall = (before.energy - after.energy)[draws].sum(axis=1) / total
    shares = np.clip(fall / np.where(gap > 0, gap, np.inf), -1.0, 1.0)
    low, high = np.quantile(shares, (0.05, 0.95))
    return float(low), float(high)


def shapley(names: Sequence[str], value: Callable[[frozenset[str]], float]) -> dict[str, float]:
    """Shapley value of each name for a value of sets; they add up to value(all) - value(none).

    Source: Shapley, A value for n-person games, Annals of Mathematics Studies 28 (1953).
    """
    n = len(names)
    shares = {}
    for name in names:
        others = [other for other in names if other != name]
        shares[name] = sum(
            math.factorial(k)
            * math.factorial(n - k - 1)
            / math.factorial(n)
            * (value(frozenset(part) | {name}) - value(frozenset(part)))
            for k in range(n)
            for part in itertools.combinations(others, k)
        )
    return shares
