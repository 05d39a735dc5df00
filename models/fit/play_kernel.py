"""Identification of the play-kernel model: non-negative least squares, its settings chosen by trials left out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial

from ..contract.metadata import Range
from ..play_kernel.step import ramps
from ..play_kernel.weights import PlayKernelWeights
from .play_kernel_settings import PlayKernelSettings
from .trial_set import angle_range, check_trial_set, command_range

Vec = NDArray[np.float64]
Progress = Callable[[int, float], None]
_JITTER = 1e-10


@dataclass(frozen=True)
class Choice:
    """One combination that is compared: time constant of the lag [s] and penalty on differences of slopes."""

    lag_s: float
    smoothness: float


@dataclass(frozen=True, eq=False)
class PlayKernelFit:
    """An identified play-kernel model.

    Attributes:
        weights: the model.
        choice: lag and smoothness that did best on trials left out.
        judged: mean offset-free error on trials left out [unit of the output] of every choice compared; empty where
            there was nothing to compare.
        rmse: mean over the training trials of the error, their own offsets taken out [unit of the output].
        interrupted: stopped by the user; the best choice so far.
    """

    weights: PlayKernelWeights
    choice: Choice
    judged: dict[Choice, float]
    rmse: float
    interrupted: bool


@dataclass(frozen=True)
class _Frame:
    """What makes commands and angles dimensionless, and what the features are made of."""

    command: Range
    angle: Range
    radii: Vec
    knots: Vec
    stops: bool
    dt: float

    def gain(self, lag_s: float) -> float:
        return 1.0 if lag_s == 0 else 1 - math.exp(-self.dt / lag_s)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Features (T, F) and scaled angle (T,) of one trial, from the first sample that counts on, and their moments."""

    features: Vec
    angle: Vec

    @cached_property
    def gram(self) -> Vec:
        """Mean products (F, F) of the features."""
        return self.features.T @ self.features / self.angle.size

    @cached_property
    def mean(self) -> Vec:
        """Means (F,) of the features."""
        return self.features.mean(axis=0)

    @cached_property
    def right(self) -> Vec:
        """Mean products (F,) of features and angle."""
        return self.features.T @ self.angle / self.angle.size


def fit_play_kernel(
    trials: Sequence[Trial],
    settings: PlayKernelSettings | None = None,
    skip_first_flexure: bool = False,
    progress: Progress | None = None,
) -> PlayKernelFit:
    """Identify a play-kernel model; every trial has equal weight and an offset of its own.

        min  mean_trials mean_t (theta - model(u) - b_trial)^2 + p sum b_trial^2 + q sum (s - s_neighbour)^2,  s >= 0

    Neighbours are the next segment of the same play and the same segment of the next play. Lag and q are those whose
    models do best, offset-free, on trials left out; whole groups of trials, never parts of one.

    Args:
        trials: uniformly sampled at one rate, in one unit; swapped ones give an inverse map, which has stops too.
        settings: see `PlayKernelSettings`.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: called with the fits so far and the least error on trials left out; KeyboardInterrupt keeps the best.

    Raises:
        FitError: on unusable trials, an angle that falls with the command, or a least-squares problem not solved.
    """
    settings = settings or PlayKernelSettings()
    frame = _frame(trials, settings)
    _line(trials)
    starts = [first_flexure_end(trial) if skip_first_flexure else 0 for trial in trials]
    choices = [Choice(*pair) for pair in itertools.product(settings.lags_s, settings.smoothness)]
    judged: dict[Choice, float] = {}
    interrupted, chosen = False, choices[len(choices) // 2]
    if len(trials) > 1 and len(choices) > 1:
        try:
            for choice in choices:
                rows = _all_rows(trials, starts, frame, choice.lag_s)
                judged[choice] = _left_out(rows, choice, frame, settings) * _span(frame.angle)
                if progress:
                    progress(len(judged), min(judged.values()))
        except KeyboardInterrupt:
            interrupted = True
        chosen = min(judged, key=lambda c: judged[c], default=chosen)
    rows = _all_rows(trials, starts, frame, chosen.lag_s)
    slopes, bias = _solve(rows, chosen, frame, settings)
    errors = [float(np.std(r.features @ slopes - r.angle)) for r in rows]
    rmse = float(np.mean(errors)) * _span(frame.angle)
    if progress:
        progress(len(judged) + 1, min(judged.values(), default=rmse))
    return PlayKernelFit(_weights(slopes, bias, trials, chosen, frame), chosen, judged, rmse, interrupted)


def _frame(trials: Sequence[Trial], settings: PlayKernelSettings) -> _Frame:
    dt, inverse = check_trial_set(trials), trials[0].inverted
    n = settings.plays
    if inverse:
        radii = np.geomspace(settings.inverse_finest, settings.inverse_reach, n)
    else:
        radii = np.linspace(0.0, settings.reach, n + 1)[1:]
    knots = np.linspace(0.0, 1.0, settings.segments + 1)
    return _Frame(command_range(trials), angle_range(trials), radii, knots, inverse, dt)


def _all_rows(trials: Sequence[Trial], starts: Sequence[int], frame: _Frame, lag_s: float) -> list[_Rows]:
    """Features of all trials: run from rest over the whole trial, then cut."""
    return [_rows(trial, start, frame, frame.gain(lag_s)) for trial, start in zip(trials, starts, strict=True)]


def _rows(trial: Trial, start: int, frame: _Frame, gain: float) -> _Rows:
    commands = (trial.command - frame.command.lower) / _span(frame.command)
    state = np.full(frame.radii.size + 1, commands[0])
    states = np.empty((commands.size, state.size))
    for k, u in enumerate(commands):
        v = u if gain == 1 else state[0] + gain * (u - state[0])
        states[k, 0], states[k, 1:] = v, np.maximum(v - frame.radii, np.minimum(v + frame.radii, state[1:]))
        state = states[k]
    features = ramps(states, frame.knots).reshape(commands.size, -1)
    if frame.stops:
        stop = states[:, :1] - states[:, 1:]
        features = np.hstack([features, np.minimum(stop, 0.0), np.maximum(stop, 0.0)])
    return _Rows(features[start:], (trial.angle[start:] - frame.angle.lower) / _span(frame.angle))


def _left_out(rows: Sequence[_Rows], choice: Choice, frame: _Frame, settings: PlayKernelSettings) -> float:
    """Mean over trials of the offset-free error of the model identified without the trial's group, scaled."""
    errors = []
    count = min(settings.folds, len(rows))
    for fold in range(count):
        slopes, _ = _solve([r for k, r in enumerate(rows) if k % count != fold], choice, frame, settings)
        errors += [float(np.std(r.features @ slopes - r.angle)) for r in rows[fold::count]]
    return float(np.mean(errors))


def _solve(rows: Sequence[_Rows], choice: Choice, frame: _Frame, settings: PlayKernelSettings) -> tuple[Vec, float]:
    """Slopes (F,) and bias, scaled: the normal equations as non-negative least squares on their Cholesky factor.

    Bias and trial offsets are free: each is the difference of two non-negative numbers.
    """
    count, trials = rows[0].features.shape[1], len(rows)
    free = 1 + trials
    gram, right = np.zeros((count + free, count + free)), np.zeros(count + free)
    for k, row in enumerate(rows):
        shown = [count, count + 1 + k]  # bias and the trial's own offset
        gram[:count, :count] += row.gram
        gram[:count, shown] += row.mean[:, None]
        gram[np.ix_(shown, shown)] += 1.0
        right[:count] += row.right - settings.least_slope * row.gram.sum(axis=1)
        right[shown] += row.angle.mean() - settings.least_slope * row.mean.sum()
    gram[count:, :count] = gram[:count, count:].T
    gram[:count, :count] += trials * choice.smoothness * _roughness(frame)
    gram[count + 1 :, count + 1 :] += settings.offset_penalty * np.eye(trials)
    both = np.hstack([np.eye(count + free), -np.eye(count + free)[:, count:]])
    gram, right = both.T @ gram @ both, both.T @ right
    factor = np.linalg.cholesky(gram + _JITTER * np.trace(gram) * np.eye(len(gram)))
    try:
        found, _ = nnls(factor.T, np.linalg.solve(factor, right), maxiter=50 * len(gram))
    except RuntimeError as error:
        raise FitError(f"play kernel: non-negative least squares of {len(gram)} unknowns: {error}") from None
    return found[:count] + settings.least_slope, float(found[count] - found[count + free])


def _roughness(frame: _Frame) -> NDArray[Any]:
    """Quadratic form sum (s - s_neighbour)^2 over segments and plays; stops are left free."""
    plays, segments = frame.radii.size + 1, frame.knots.size - 1

    def chain(size: int) -> Vec:
        steps = np.diff(np.eye(size), axis=0)
        return steps.T @ steps

    form = np.kron(np.eye(plays), chain(segments)) + np.kron(chain(plays), np.eye(segments))
    if not frame.stops:
        return form
    size = len(form)
    whole = np.zeros((size + 2 * (plays - 1),) * 2)
    whole[:size, :size] = form
    return whole


def _weights(slopes: Vec, bias: float, trials: Sequence[Trial], choice: Choice, frame: _Frame) -> PlayKernelWeights:
    """Back to the units of command and angle."""
    plays, segments = frame.radii.size + 1, frame.knots.size - 1
    command, angle = _span(frame.command), _span(frame.angle)
    physical = slopes * angle / command
    inner = physical[: plays * segments].reshape(plays, segments)
    return PlayKernelWeights(
        gain=frame.gain(choice.lag_s),
        lower=frame.command.lower,
        upper=frame.command.upper,
        radii=frame.radii * command,
        knots=frame.command.lower + frame.knots * command,
        slopes=inner,
        bias=frame.angle.lower + bias * angle,
        outer_slope=_line(trials),
        stops=physical[plays * segments :].reshape(2, -1) if frame.stops else None,
    )


def _line(trials: Sequence[Trial]) -> float:
    """Slope of the one line through all samples [deg/cmd].

    Raises:
        FitError: if it does not rise.
    """
    u, y = (np.concatenate([getattr(trial, name) for trial in trials]) for name in ("command", "angle"))
    slope = float(np.polyfit(u, y, 1)[0])
    if slope <= 0:
        raise FitError(
            f"the angle falls with the command ({slope:.4g} {trials[0].units.angle} per {trials[0].units.command}), "
            "expected it to rise; turn the sign of one channel"
        )
    return slope


def _span(bounds: Range) -> float:
    return bounds.upper - bounds.lower
