"""Identification of the play-kernel model: non-negative least squares, its settings chosen by trials left out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial

from ..contract.metadata import Range
from ..play_kernel.follow import follow_plays
from ..play_kernel.step import ramps
from ..play_kernel.weights import PlayKernelWeights
from .play_kernel_settings import PlayKernelSettings
from .trial_set import angle_range, check_trial_set, command_range

Vec = NDArray[np.float64]
Progress = Callable[[int, float], None]
_JITTER = 1e-10
_BLOCK = 16_384  # samples whose features are held at once, 25 MB


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
class _Moments:
    """Mean products of one trial's features (F,) with each other and with its scaled angle, from the first sample that
    counts on: all that a fit takes from it."""

    gram: Vec
    mean: Vec
    right: Vec
    angle: float


@final
class _Course:
    """One trial on its way through the plays, a block of samples at a time.

    The features of a sample are some 200 numbers: of five million samples they would be 8 GB.
    """

    def __init__(self, trial: Trial, start: int, frame: _Frame, lag_s: float) -> None:
        self._trial, self._start, self._frame, self._gain = trial, start, frame, frame.gain(lag_s)

    def blocks(self) -> Iterator[tuple[Vec, Vec]]:
        """Features (T, F) and scaled angle (T,) of the samples that count; the plays run from rest over all."""
        trial, frame = self._trial, self._frame
        state = np.full(frame.radii.size + 1, _scaled(trial.command[0], frame.command))
        for first in range(0, len(trial), _BLOCK):
            block = slice(first, first + _BLOCK)
            states = follow_plays(_scaled(trial.command[block], frame.command), self._gain, frame.radii, state)
            state, cut = states[-1].copy(), max(self._start - first, 0)
            if cut < len(states):
                yield self._features(states[cut:]), _scaled(trial.angle[block], frame.angle)[cut:]

    @cached_property
    def moments(self) -> _Moments:
        """Of all blocks together."""
        count, gram, mean, right, angle = 0, 0.0, 0.0, 0.0, 0.0
        for x, y in self.blocks():
            count += y.size
            gram, mean, right, angle = gram + x.T @ x, mean + x.sum(axis=0), right + x.T @ y, angle + y.sum()
        return _Moments(*(np.asarray(total) / count for total in (gram, mean, right)), float(angle / count))

    def scatter(self, slopes: Vec) -> Vec:
        """Standard deviation (S,) of the errors of models with slopes (F, S): each may have an offset of its own."""
        count, mean, square = 0, np.zeros(slopes.shape[1]), np.zeros(slopes.shape[1])
        for x, y in self.blocks():
            errors = x @ slopes - y[:, None]
            own = errors.mean(axis=0)
            share = y.size / (count + y.size)  # joined as in Chan, Golub, LeVeque, Amer. Statist. 37 (1983)
            square += np.sum((errors - own) ** 2, axis=0) + count * share * (own - mean) ** 2
            mean, count = mean + share * (own - mean), count + y.size
        return np.asarray(np.sqrt(square / count), dtype=np.float64)

    def _features(self, states: Vec) -> Vec:
        features = ramps(states, self._frame.knots).reshape(len(states), -1)
        if not self._frame.stops:
            return features
        stop = states[:, :1] - states[:, 1:]
        return np.hstack([features, np.minimum(stop, 0.0), np.maximum(stop, 0.0)])


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
            for lag_s in settings.lags_s:
                courses = [_Course(*pair, frame, lag_s) for pair in zip(trials, starts, strict=True)]
                for choice, error in _left_out(courses, lag_s, frame, settings):
                    judged[choice] = error * _span(frame.angle)
                    if progress:
                        progress(len(judged), min(judged.values()))
        except KeyboardInterrupt:
            interrupted = True
        chosen = min(judged, key=lambda c: judged[c], default=chosen)
    courses = [_Course(*pair, frame, chosen.lag_s) for pair in zip(trials, starts, strict=True)]
    slopes, bias = _solve([course.moments for course in courses], chosen, frame, settings)
    rmse = float(np.mean([course.scatter(slopes[:, None])[0] for course in courses])) * _span(frame.angle)
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


def _left_out(
    courses: Sequence[_Course], lag_s: float, frame: _Frame, settings: PlayKernelSettings
) -> Iterator[tuple[Choice, float]]:
    """Mean over trials of the offset-free error of models identified without the trial's group, scaled, by choice."""
    choices = [Choice(lag_s, smoothness) for smoothness in settings.smoothness]
    moments = [course.moments for course in courses]
    count = min(settings.folds, len(courses))
    errors = np.empty((len(courses), len(choices)))
    for fold in range(count):
        rest = [m for k, m in enumerate(moments) if k % count != fold]
        slopes = np.stack([_solve(rest, choice, frame, settings)[0] for choice in choices], axis=1)
        for k in range(fold, len(courses), count):
            errors[k] = courses[k].scatter(slopes)
    yield from zip(choices, errors.mean(axis=0).tolist(), strict=True)


def _solve(rows: Sequence[_Moments], choice: Choice, frame: _Frame, settings: PlayKernelSettings) -> tuple[Vec, float]:
    """Slopes (F,) and bias, scaled: the normal equations as non-negative least squares on their Cholesky factor.

    Bias and trial offsets are free: each is the difference of two non-negative numbers.
    """
    count, trials = rows[0].mean.size, len(rows)
    free = 1 + trials
    gram, right = np.zeros((count + free, count + free)), np.zeros(count + free)
    for k, row in enumerate(rows):
        shown = [count, count + 1 + k]  # bias and the trial's own offset
        gram[:count, :count] += row.gram
        gram[:count, shown] += row.mean[:, None]
        gram[np.ix_(shown, shown)] += 1.0
        right[:count] += row.right - settings.least_slope * row.gram.sum(axis=1)
        right[shown] += row.angle - settings.least_slope * row.mean.sum()
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
    samples = sum(len(trial) for trial in trials)
    middle = sum(float(t.command.sum()) for t in trials) / samples, sum(float(t.angle.sum()) for t in trials) / samples
    products = sum(float((t.command - middle[0]) @ (t.angle - middle[1])) for t in trials)
    slope = products / sum(float(np.sum((t.command - middle[0]) ** 2)) for t in trials)
    if slope <= 0:
        raise FitError(
            f"the angle falls with the command ({slope:.4g} {trials[0].units.angle} per {trials[0].units.command}), "
            "expected it to rise; turn the sign of one channel"
        )
    return slope


def _scaled(values: Any, bounds: Range) -> Any:
    return (values - bounds.lower) / _span(bounds)


def _span(bounds: Range) -> float:
    return bounds.upper - bounds.lower
