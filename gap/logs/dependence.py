"""Test of whether the angle of a trial depends on its command."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mat, Vec

from .motion_type import past_features
from .sensor import autocorrelation

_DRAWS = 199  # of the null: the lowest level of significance is 1 in 200
_LEVEL = 0.01
_RIDGES = (1e-3, 1e-1, 1.0)  # of the mean eigenvalue of the features' Gram matrix
_SURELY = 0.25  # share of the energy (correlation 0.5) that needs no test
_EXPECTED = 0.25  # of the motion expected in all trials, below which a trial cannot be tested
_SCATTER = 2.0  # standard deviations by which one trial may follow less than the others, where all follow little
_PER_LAG = 8  # means that are kept of the time over which changes are taken
_LEAST_BLOCKS = 8  # of a trial
_PARTS = 4  # that a single trial is cut into


@dataclass(frozen=True, eq=False)
class _Part:
    """A trial, or a part of a single one, by its sums: of features (F, F), of features and the changes of the angle as
    recorded and in other orders (F, 1 + D), of the squared changes (1 + D,)."""

    gram: Mat
    products: Mat
    energy: Vec
    samples: float


def follows_command(trials: Sequence[Trial], seed: int = 0) -> tuple[bool, ...]:
    """Whether the angle of each trial depends on the past of its command, or nothing contradicts it.

    Changes y of the angle are regressed on those of features of the command's past (levels, speeds, lags, low-passes,
    plays) by ridge regression over all trials but one, and expected in that one:

        share = 1 - sum_trials |y - expected|^2 / sum_trials |y|^2,   r = y . expected / (|y| |expected|)

    Changes are taken over the time in which the command loses half of its variance, since the level of a drifting angle
    correlates with any slow command. The null distribution comes from the changes of each trial in another order of
    blocks, which keeps noise, drift and jumps and removes the dependence on the command.

    All trials together depend on their commands where the share is above a quarter, or above the 99 % quantile of the
    null, and where r is above 0.5, or above the 99 % quantile of its own null, in half of the trials. Then a trial
    follows where that holds for its own r, where r is below that of the median trial by chance only, or where little
    motion is expected of it (a command at rest or within the play of the device). Otherwise the trials whose own r is
    significant follow if they are half of all or more and depend on their commands without the others.

    Sources: Granger, Newbold, Spurious regressions in econometrics, J. Econometrics 2 (1974); Theiler et al., Testing
    for nonlinearity in time series: the method of surrogate data, Physica D 58 (1992).

    Args:
        trials: uniform, at one rate.
        seed: of the orders.
    """
    parts = _parts(trials, seed)
    if len(trials) == 1:
        return (_depends(*_held_out_share(parts)[:2]),)
    share, chance, expected = _held_out_share(parts)
    correlations = [_correlation(part, weights) for part, weights in zip(parts, expected, strict=True)]
    unseen = _little_motion(parts, expected)
    sure = [_is_significant(r) and not small for r, small in zip(correlations, unseen, strict=True)]
    majority = sum(sure) >= 0.5 * (len(trials) - sum(unseen))
    if majority and _depends(share, chance):
        usual = float(np.median([float(r[0]) for r, small in zip(correlations, unseen, strict=True) if not small]))
        follows = [
            small or significant or float(r[0]) > usual - _SCATTER * float(r[1:].std())
            for r, significant, small in zip(correlations, sure, unseen, strict=True)
        ]
    else:
        sure_parts = [part for part, kept in zip(parts, sure, strict=True) if kept]
        enough = len(sure_parts) >= max(len(trials) / 2, 2) and _depends(*_held_out_share(sure_parts)[:2])
        follows = sure if enough else [False] * len(trials)
    return tuple(follows)


def _depends(share: float, chance: float) -> bool:
    return share > _SURELY or share > max(chance, 0.0)


def _is_significant(correlations: Vec) -> bool:
    """Whether the correlation of a trial is large, or significant against its null distribution (1 + D,)."""
    recorded = float(correlations[0])
    return recorded > math.sqrt(_SURELY) or recorded > float(np.quantile(correlations[1:], 1 - _LEVEL, method="higher"))


def _little_motion(parts: Sequence[_Part], expected: Sequence[Mat]) -> list[bool]:
    """Trials in which little motion is expected."""
    sizes = [float(w[:, 0] @ p.gram @ w[:, 0]) / p.samples for p, w in zip(parts, expected, strict=True)]
    return [size < _EXPECTED**2 * float(np.mean(sizes)) for size in sizes]


def _parts(trials: Sequence[Trial], seed: int) -> list[_Part]:
    random = np.random.default_rng(seed)
    parts = []
    for trial, features in zip(trials, past_features(trials), strict=True):
        lag = _lag(trial.command)
        width = max(lag // _PER_LAG, 1)
        steps = max(round(lag / width), 1)
        x, y = (_changes(signal, width, steps) for signal in (features, trial.angle[:, None]))
        length = max(min(2 * steps, len(y) // _LEAST_BLOCKS), 1)
        shown = [y[:, 0], *(y[_reordered(len(y), length, random), 0] for _ in range(_DRAWS))]
        edges = np.linspace(0, len(y), _PARTS + 1 if len(trials) == 1 else 2).astype(np.intp).tolist()
        parts += [_part(x[a:b], [order[a:b] for order in shown], width) for a, b in itertools.pairwise(edges)]
    return parts


def _part(x: Mat, shown: Sequence[Vec], width: int) -> _Part:
    products = np.stack([changes @ x for changes in shown], axis=1)
    return _Part(
        width * x.T @ x, width * products, width * np.array([changes @ changes for changes in shown]), width * len(x)
    )


def _lag(command: Vec) -> int:
    """Samples after which the mean square change of a command reaches its variance, at most an eighth of it."""
    most = max(command.size // _LEAST_BLOCKS, 1)
    u = command - command.mean()
    together = autocorrelation(u, most + 1)[1:] / np.arange(u.size - 1, u.size - 1 - most, -1)
    reached = np.flatnonzero(2 * (float(np.mean(u**2)) - together) >= float(np.mean(u**2)))
    return int(reached[0]) + 1 if reached.size else most


def _changes(signal: Mat, width: int, steps: int) -> Mat:
    """Changes over so many steps of the means over `width` samples, about their mean."""
    count = len(signal) // width
    means = signal[: count * width].reshape(count, width, -1).mean(axis=1)
    changes = means[steps:] - means[:-steps]
    return np.asarray(changes - changes.mean(axis=0), dtype=np.float64)


def _reordered(size: int, length: int, random: np.random.Generator) -> NDArray[np.intp]:
    """Indices of `size` samples after a random permutation of blocks of one length."""
    blocks = max(size // length, 1)
    block = np.roll(np.arange(size) * blocks // size, int(random.integers(size)))
    return np.argsort(random.permutation(blocks)[block], kind="stable")


def _held_out_share(parts: Sequence[_Part]) -> tuple[float, float, list[Mat]]:
    """Share explained, its quantile by chance, and the weights (F, 1 + D) for each part, fitted to the others."""
    gram, products = np.sum([p.gram for p in parts], axis=0), np.sum([p.products for p in parts], axis=0)
    energy = np.maximum(np.sum([p.energy for p in parts], axis=0), 1e-300)
    best, kept = np.full(energy.size, -np.inf), list[Mat]()
    for ridge in _RIDGES:
        left, weights = np.zeros_like(energy), list[Mat]()
        for part in parts:
            rest = gram - part.gram
            damping = ridge * float(np.trace(rest)) / len(rest) + 1e-12
            coefficients = np.linalg.solve(rest + damping * np.eye(len(rest)), products - part.products)
            product, square = coefficients * part.products, coefficients * (part.gram @ coefficients)
            left += part.energy - 2 * np.sum(product, axis=0) + np.sum(square, axis=0)
            weights.append(coefficients)
        share = 1 - left / energy
        if share[0] > best[0]:
            kept = weights
        best = np.maximum(best, share)
    return float(best[0]), float(np.quantile(best[1:], 1 - _LEVEL, method="higher")), kept


def _correlation(part: _Part, weights: Mat) -> Vec:
    """Correlation of a part's changes, recorded and permuted (1 + D,), with predicted ones; 0 where either is zero."""
    expected = weights[:, 0]
    size = np.sqrt(max(float(expected @ part.gram @ expected), 0.0) * np.maximum(part.energy, 0.0))
    return np.divide(expected @ part.products, size, out=np.zeros_like(size), where=size > 1e-12)
