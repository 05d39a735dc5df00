"""Support-vector regression by scikit-learn: its grid search, and the final model."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Vec

from ..contract.metadata import Range
from ..identify.trial_set import angle_range, check_trial_set, command_range
from ..svr.weights import SvrWeights
from .svr_settings import SvrSettings

Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class SvrChoice:
    """One combination that is compared."""

    c: float
    gamma: float
    epsilon: float


@dataclass(frozen=True, eq=False)
class SvrFit:
    """An identified support-vector regression.

    Attributes:
        weights: the model.
        choice: the combination with the least error on what was left out.
        judged: that error, root mean square, of every combination compared [unit of the output].
        rmse: of the final model on its own samples [unit of the output].
        samples: samples it was fitted to.
        interrupted: stopped by the user; the best choice so far.
    """

    weights: SvrWeights
    choice: SvrChoice
    judged: dict[SvrChoice, float]
    rmse: float
    samples: int
    interrupted: bool


@dataclass(frozen=True, eq=False)
class _Samples:
    """Scaled windows (T, L), scaled angles (T,), and the trial that each is from (T,)."""

    windows: Vec
    angles: Vec
    trials: Index

    def drawn(self, count: int, rng: np.random.Generator) -> _Samples:
        """At most `count` of them, in order."""
        if count >= self.angles.size:
            return self
        kept = np.sort(rng.choice(self.angles.size, count, replace=False))
        return _Samples(self.windows[kept], self.angles[kept], self.trials[kept])


def fit_svr(
    trials: Sequence[Trial],
    settings: SvrSettings | None = None,
    skip_first_flexure: bool = False,
    progress: Progress | None = None,
) -> SvrFit:
    """Identify a support-vector regression; before its first command a trial is taken to have been at rest.

    Args:
        trials: uniformly sampled at one rate, in one unit; swapped ones give an inverse map.
        settings: see `SvrSettings`.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: called with the fits so far and the least error; KeyboardInterrupt keeps the best choice.

    Raises:
        FitError: on unusable trials, or if scikit-learn is not installed.
    """
    settings = settings or SvrSettings()
    check_trial_set(trials)
    _regressor()
    samples, rng = _samples(trials, settings, skip_first_flexure), np.random.default_rng(settings.seed)
    choices = [SvrChoice(*values) for values in itertools.product(settings.c, settings.gamma, settings.epsilon)]
    judged: dict[SvrChoice, float] = {}
    half = 0.5 * (angle_range(trials).upper - angle_range(trials).lower)
    interrupted = False
    if len(choices) > 1:
        few = samples.drawn(settings.compared_samples, rng)
        folds = _folds(few, settings, rng)
        try:
            for choice in choices:
                judged[choice] = half * _left_out(few, folds, choice, settings.cache_mb)
                if progress:
                    progress(len(judged), min(judged.values()))
        except KeyboardInterrupt:
            interrupted = True
    chosen = min(judged, key=lambda c: judged[c], default=choices[0])
    kept = samples.drawn(settings.samples, rng)
    machine = _fitted(kept.windows, kept.angles, chosen, settings.cache_mb)
    rmse = half * float(np.sqrt(np.mean((machine.predict(kept.windows) - kept.angles) ** 2)))
    if progress:
        progress(len(judged) + 1, min(judged.values(), default=rmse))
    return SvrFit(
        _weights(machine, chosen, trials, settings.stride), chosen, judged, rmse, kept.angles.size, interrupted
    )


def _samples(trials: Sequence[Trial], settings: SvrSettings, skip_first_flexure: bool) -> _Samples:
    command, angle = command_range(trials), angle_range(trials)
    windows, angles, numbers = [], [], []
    for k, trial in enumerate(trials):
        start = first_flexure_end(trial) if skip_first_flexure else 0
        past = (settings.lags - 1) * settings.stride
        padded = np.concatenate([np.full(past, trial.command[0]), trial.command])
        seen = np.lib.stride_tricks.sliding_window_view(padded, past + 1)[start:, :: settings.stride]
        windows.append(_scaled(seen, command))
        angles.append(_scaled(trial.angle[start:], angle))
        numbers.append(np.full(len(trial) - start, k))
    return _Samples(np.concatenate(windows), np.concatenate(angles), np.concatenate(numbers))


def _scaled(values: Vec, bounds: Range) -> Vec:
    """The range becomes -1 to 1."""
    return (2 * values - bounds.lower - bounds.upper) / (bounds.upper - bounds.lower)


def _folds(samples: _Samples, settings: SvrSettings, rng: np.random.Generator) -> list[NDArray[np.bool_]]:
    """Masks of what is left out."""
    count = settings.folds
    numbers = np.unique(samples.trials)
    if settings.by_trial and numbers.size > 1:
        return [np.isin(samples.trials, numbers[k::count]) for k in range(min(count, numbers.size))]
    drawn = rng.permutation(samples.angles.size) % count
    return [drawn == k for k in range(count)]


def _left_out(samples: _Samples, folds: Sequence[NDArray[np.bool_]], choice: SvrChoice, cache_mb: int) -> float:
    """Root mean square error over all folds, scaled."""
    squares = 0.0
    for out in folds:
        machine = _fitted(samples.windows[~out], samples.angles[~out], choice, cache_mb)
        squares += float(np.sum((machine.predict(samples.windows[out]) - samples.angles[out]) ** 2))
    return float(np.sqrt(squares / sum(int(out.sum()) for out in folds)))


def _fitted(windows: Vec, angles: Vec, choice: SvrChoice, cache_mb: int) -> Any:
    machine = _regressor()(
        kernel="rbf", C=choice.c, gamma=choice.gamma, epsilon=choice.epsilon, cache_size=cache_mb
    ).fit(windows, angles)
    if not len(machine.support_):
        raise FitError(
            f"SVR: no support vector, all scaled angles lie within epsilon {choice.epsilon:g} of one value; "
            "expected a smaller epsilon"
        )
    return machine


def _weights(machine: Any, choice: SvrChoice, trials: Sequence[Trial], stride: int) -> SvrWeights:
    command, angle = command_range(trials), angle_range(trials)
    return SvrWeights(
        supports=machine.support_vectors_,
        coefficients=machine.dual_coef_[0],
        bias=float(machine.intercept_[0]),
        gamma=choice.gamma,
        u_offset=0.5 * (command.lower + command.upper),
        u_scale=0.5 * (command.upper - command.lower),
        theta_offset=0.5 * (angle.lower + angle.upper),
        theta_scale=0.5 * (angle.upper - angle.lower),
        stride=stride,
    )


def _regressor() -> Any:
    """scikit-learn's SVR; the core installs without it.

    Raises:
        FitError: if scikit-learn is not installed.
    """
    try:
        from sklearn.svm import SVR  # type: ignore[import-untyped]
    except ImportError:
        raise FitError("SVR needs scikit-learn, expected `pip install hystmpc[train]`") from None
    return SVR
