"""Memory of a residual: share of it that features of the command's past explain on trials held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hystmpc.trials.segments import segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mat, Vec

from ..logs.motion_type import MEMORIES, memory_features, past_features, play_states
from ..logs.noise_floor import require_residuals

_RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # of the mean eigenvalue of the features' Gram matrix
_RIDGE = 1e-3
_RANDOM = 160  # random features
_HALF_WIDTHS, _PLAYS = (0.005, 0.2), 8  # of the command's range
_STIFF = (1e-6, 1e-5, 1e-4, 1e-3)  # ridges for plays, which resemble each other
_PARTS = 4  # a single trial is cut into


def memory_gains(
    trials: Sequence[Trial], residuals: Sequence[Vec], loop_width: float, ordered: bool = True
) -> dict[str, float]:
    """Share of the residual's energy about its mean that each memory explains held out, by name; below 0 if none.

    Ridge regression on a few features of speed (|v|, v, sign), time since the last reversal and age of the hold
    (decaying exponentials times the last direction), travel since the reversal (in loop widths) and in all, and the
    clock, over all trials but one, applied to that one. A trial that stands alone is cut into four.

    Args:
        trials: uniform, at one rate.
        residuals: (T,) each [deg].
        loop_width: width of the hysteresis loop along the command [cmd].
        ordered: whether the trials stand in the order of recording; if not, the clock starts anew in each.

    Raises:
        GapError: if residuals do not fit the trials or are not finite.
        LogError: if a trial is not uniform.
    """
    require_residuals(trials, residuals)
    clocks = np.concatenate([[0.0], np.cumsum([trial.duration_s if ordered else 0.0 for trial in trials])])
    features = [memory_features(trial, loop_width, float(t)) for trial, t in zip(trials, clocks[:-1], strict=True)]
    targets = _folded(residuals)
    total = float(_held_out([np.zeros((y.size, 0)) for y in targets], targets, (_RIDGE,)).sum())
    gains = {}
    for name in MEMORIES:
        missed = _held_out(_folded([trial_features[name] for trial_features in features]), targets, (_RIDGE,))[0]
        gains[name] = float(np.clip(1 - missed.sum() / total, -1.0, 1.0)) if total > 0 else 0.0
    return gains


def explainable_share(trials: Sequence[Trial], residuals: Sequence[Vec], seed: int = 0) -> float:
    """Share of the residual's energy that a flexible model of the command's past explains held out, 0 to 1.

    Leave-one-trial-out ridge regression on lagged commands, speeds, play states of six widths, commands low-passed at
    five time constants, and `tanh` of random mixtures of these. The ridge, and whether the random features are used,
    are chosen for each trial on the others. A trial that the regression makes worse counts as unexplained.

    Args:
        trials: uniform, at one rate.
        residuals: (T,) each [deg].
        seed: of the random mixtures.

    Raises:
        GapError: if residuals do not fit the trials or are not finite.
        LogError: if a trial is not uniform.
    """
    require_residuals(trials, residuals)
    targets = _folded(residuals)
    energies = np.array([float(y @ y) for y in targets])
    energy = float(energies.sum())
    if energy <= 0:
        return 0.0
    plain = _folded(past_features(trials))
    size = plain[0].shape[1]
    random = np.random.default_rng(seed)
    mixing = random.standard_normal((size, _RANDOM)) / np.sqrt(size)
    phase = random.uniform(-1.5, 1.5, _RANDOM)

    def mixed(x: Mat) -> Mat:
        return np.concatenate([x, np.tanh(1.5 * x @ mixing + phase)], axis=1)

    missed = np.concatenate([_held_out(plain, targets, _RIDGES), _held_out(plain, targets, _RIDGES, mixed)])
    others = missed.sum(axis=1, keepdims=True) - missed
    chosen = np.argmin(others, axis=0)
    explained = 1 - float(np.minimum(missed[chosen, np.arange(len(targets))], energies).sum()) / energy
    return float(np.clip(explained, 0.0, 1.0))


def friction_share(trials: Sequence[Trial], residuals: Sequence[Vec], noise_deg: float) -> float:
    """Share of the residual's energy above the noise that plays of the command explain held out, 0 to 1.

    r = c + a_0 u + sum_i a_i z_i,  z_i the plays of half-widths from 0.5 to 20 % of the command's range

    is what a Prandtl-Ishlinskii model of other weights and widths would add to the simulator: friction that has grown
    or is spread in another way. Ridge regression, each trial left out once. The plays begin where the command came
    down to its start, rose to it, or never moved before; the best of the three counts. What comes before the first
    reversal of a trial does not count: a set that is taken on the first way looks like friction. A trial weighs by its
    RMS, not by its energy: one large motion that is like no other cannot be predicted from the others.

    Args:
        trials: uniform, at one rate.
        residuals: (T,) each [deg].
        noise_deg: white noise of the residuals [deg].
    """
    require_residuals(trials, residuals)
    starts = [int(next(iter(segment(trial).reversals), 0)) for trial in trials]
    targets = _folded([error[k:] for error, k in zip(residuals, starts, strict=True)])
    energies = np.array([float(y @ y) for y in targets])
    weights = 1 / np.sqrt(np.maximum(energies, np.finfo(np.float64).tiny))
    energy = float(energies @ weights)
    noise = noise_deg**2 * float(np.array([y.size for y in targets]) @ weights)
    if energy <= noise:
        return 0.0
    span = max(float(np.ptp(trial.command)) for trial in trials) or 1.0
    half = span * np.geomspace(*_HALF_WIDTHS, _PLAYS)
    missed = []
    for side in (-1.0, 0.0, 1.0):
        rows = [
            np.column_stack([trial.command, play_states(trial.command, half, side)])[k:] / span
            for trial, k in zip(trials, starts, strict=True)
        ]
        missed.append(float((_held_out(_folded(rows), targets, _STIFF) @ weights).min()))
    return float(np.clip((energy - min(missed)) / (energy - noise), 0.0, 1.0))


def locked_part(trials: Sequence[Trial], residuals: Sequence[Vec]) -> list[Vec]:
    """Part of the residuals (T,) that `past_features` explain by one ridge fit over all trials."""
    rows = [_with_one(x) for x in past_features(trials)]
    gram = np.sum([x.T @ x for x in rows], axis=0)
    product = np.sum([x.T @ e for x, e in zip(rows, residuals, strict=True)], axis=0)
    ridge = _RIDGE * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
    weights = np.linalg.solve(gram + ridge, product)
    return [x @ weights for x in rows]


def _folded(signals: Sequence[Mat]) -> list[Mat]:
    """Signals (T, ...) of every trial; of a single trial its parts."""
    if len(signals) > 1:
        return list(signals)
    edges = np.linspace(0, len(signals[0]), _PARTS + 1).astype(np.intp)
    return np.split(signals[0], edges[1:-1])


def _held_out(
    rows: Sequence[Mat], targets: Sequence[Vec], ridges: Sequence[float], more: Callable[[Mat], Mat] | None = None
) -> Mat:
    """Squared errors (ridges, folds) on each fold of a ridge fit with intercept to the others.

    `more` adds features that are made of these, for one fold at a time: of all folds they would be gigabytes.
    """

    def features(k: int) -> Mat:
        return _with_one(rows[k] if more is None else more(rows[k]))

    moments = []
    for k, y in enumerate(targets):
        x = features(k)
        moments.append((x.T @ x, x.T @ y))
    gram, product = (np.sum([m[j] for m in moments], axis=0) for j in (0, 1))
    missed = np.empty((len(ridges), len(rows)))
    for k in range(len(rows)):
        rest = gram - moments[k][0]
        scale, turn = np.linalg.eigh(rest)
        seen = turn.T @ (product - moments[k][1])
        shown = features(k) @ turn
        for j, ridge in enumerate(ridges):
            damped = np.maximum(scale, 0.0) + ridge * float(np.mean(np.maximum(scale, 0.0)))
            missed[j, k] = float(np.sum((targets[k] - shown @ (seen / damped)) ** 2))
    return missed


def _with_one(x: Mat) -> Mat:
    return np.concatenate([np.ones((len(x), 1)), x], axis=1)
