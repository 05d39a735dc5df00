"""Support-vector regression by scikit-learn: settings, comparison of choices, final model, and its model file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sklearn.svm import SVR  # type: ignore[import-untyped]

from hystmpc.models.contract.export import ExportBundle
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.identify.runs import angle_range, check_trial_set, command_range, facts_of, fixed_rule
from hystmpc.models.model import FitProgress
from hystmpc.models.motions import probe_commands
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Vec

from .svr import SvrStep, SvrWeights, svr_step_graph

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class SvrSettings(Settings):
    """Settings of the identification of a support-vector regression; see `SvrWeights` and `fit_svr`.

    Commands and angles are scaled so that the trained ranges become -1 to 1; `epsilon` is in the unit of that angle.

    Attributes:
        name: of the training, in reports.
        lags: commands in a window.
        stride: samples between them; 50 commands every 5 samples are 10 s at 25 Hz, a period of the slowest motions.
        c, gamma, epsilon: values that are compared; one of each is no comparison.
        folds: parts of the comparison.
        by_trial: leave whole trials out in the comparison; else samples drawn at random, as S1 (RA-L 2021) may do.
            Neighbouring windows are nearly the same, so that random folds know what they are judged on.
        compared_samples: greatest number of samples in the comparison, drawn at random.
        samples: greatest number of samples that the final model is fitted to, drawn at random.
        cache_mb: kernel cache of libsvm [MB].
        seed: of the draws.
    """

    name: str = "best"
    lags: Annotated[int, Field(ge=2)] = 50
    stride: Count = 5
    c: tuple[Positive, ...] = Field(default=(1.0, 10.0, 100.0), min_length=1)
    gamma: tuple[Positive, ...] = Field(default=(0.0003, 0.001, 0.003), min_length=1)
    epsilon: tuple[Positive, ...] = Field(default=(0.05,), min_length=1)
    folds: Annotated[int, Field(ge=2)] = 6
    by_trial: bool = True
    compared_samples: Annotated[int, Field(ge=50)] = 1500
    samples: Annotated[int, Field(ge=50)] = 10_000
    cache_mb: Count = 400
    seed: int = 1


SVR_TRAININGS: Mapping[str, SvrSettings] = {
    "best": SvrSettings(),
    # S1: the values found by its grid search
    "paper": SvrSettings(name="paper", stride=1, c=(10.0,), gamma=(0.1,), epsilon=(0.1,), samples=100_000),
    # S1: the grid search itself
    "grid": SvrSettings(
        name="grid",
        stride=1,
        c=(0.001, 0.01, 0.1, 1.0, 10.0),
        gamma=(0.001, 0.01, 0.1, 1.0),
        epsilon=(0.1,),
        folds=10,
        by_trial=False,
        samples=100_000,
    ),
}


@dataclass(frozen=True)
class SvrChoice:
    """Combination of settings in the comparison."""

    c: float
    gamma: float
    epsilon: float


@dataclass(frozen=True, eq=False)
class SvrFit:
    """Identified support-vector regression.

    Attributes:
        choice: the combination with the least error on what was left out.
        judged: that error, root mean square, of every combination compared [unit of the output].
        rmse: of the final model on its own samples [unit of the output].
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
    """Scaled windows (T, L), scaled angles (T,), and the trial number of each (T,)."""

    windows: Vec
    angles: Vec
    trials: Index

    def drawn(self, count: int, rng: np.random.Generator) -> _Samples:
        """Random subset of at most `count` samples, in order."""
        if count >= self.angles.size:
            return self
        kept = np.sort(rng.choice(self.angles.size, count, replace=False))
        return _Samples(self.windows[kept], self.angles[kept], self.trials[kept])


def fit_svr(
    trials: Sequence[Trial],
    settings: SvrSettings | None = None,
    skip_first_flexure: bool = False,
    progress: FitProgress | None = None,
) -> SvrFit:
    """Identify a support-vector regression; each trial is assumed to be at rest before its first command.

    Args:
        trials: uniformly sampled at one rate, in one unit; swapped ones give an inverse map.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: called with the fits so far and the least error; KeyboardInterrupt keeps the best choice.
    """
    settings = settings or SvrSettings()
    check_trial_set(trials)
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


def svr_bundle(fit: SvrFit, trials: Sequence[Trial], settings: SvrSettings, limits: DeviceLimits) -> ExportBundle:
    """Graph, facts, reference and probe of a support-vector regression for `export_onnx`.

    Fresh and conditioned devices start alike: a window forgets what is older, and the warm-up fills it.
    """
    past = fit.weights.state_size
    rest = fixed_rule(np.full(past, float(np.mean([trial.command[0] for trial in trials]))))
    metadata = facts_of(
        "svr",
        trials,
        limits,
        (rest, rest),
        past,
        {
            "preset": settings.name,
            "settings": settings.model_dump_json(),
            "c": fit.choice.c,
            "gamma": fit.choice.gamma,
            "epsilon": fit.choice.epsilon,
            "training_rmse": fit.rmse,
            "interrupted": fit.interrupted,
        },
    )
    return ExportBundle(svr_step_graph(fit.weights), metadata, SvrStep(fit.weights), probe_commands(metadata))


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
    """Values scaled so that the range becomes -1 to 1."""
    return (2 * values - bounds.lower - bounds.upper) / (bounds.upper - bounds.lower)


def _folds(samples: _Samples, settings: SvrSettings, rng: np.random.Generator) -> list[NDArray[np.bool_]]:
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
    gamma: Any = choice.gamma  # scikit-learn's own types know its words alone
    machine = SVR(kernel="rbf", C=choice.c, gamma=gamma, epsilon=choice.epsilon, cache_size=cache_mb)
    machine.fit(windows, angles)
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
