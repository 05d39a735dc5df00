"""Identification of the play-kernel model by non-negative least squares; settings are chosen on held-out trials."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import nnls

from hystmpc.trials.config import Count, NotNegative, Positive, Settings
from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.export import ExportBundle
from ..contract.metadata import DeviceLimits, Range
from ..identify.chain_kinds import falls
from ..identify.estimation_noise import with_noise
from ..identify.runs import angle_range, check_trial_set, command_range, facts_of, fixed_rule
from ..kinds.kind import FitRequest, Identified, ModelKind, recorded
from ..model import FitProgress
from ..motions import flexed, probe_commands
from .predictor import follow_plays
from .weights import PlayKernelStep, PlayKernelWeights, play_kernel_graph, ramps


class PlayKernelSettings(Settings):
    """Settings of a play-kernel model and its identification; see `PlayKernelWeights` and `fit_play_kernel`.

    Commands are counted in units of the trained command range, angles in units of the trained angle range.

    Attributes:
        name: of the training, in reports.
        plays: number n of plays with a positive radius.
        reach: greatest radius; the radii of a forward model are spread evenly up to it.
        inverse_reach, inverse_finest: greatest and least radius of an inverse map, spread evenly in their logarithm: a
            reversal of the angle asks for a jump across the whole loop, which only plays of small radius can follow.
        segments: number K of linear pieces of each function.
        lags_s: time constants of the lag in front that are compared, 0 for none [s].
        smoothness: penalties on the differences of neighbouring slopes that are compared.
        offset_penalty: on the square of the trial offsets; an offset b of a trial is known up to the factor 1 / (1 +
            penalty). Angle sensors are zeroed anew for each trial, and a model that bends to follow the offsets of its
            training trials does worse on the next one. Large values turn offsets off.
        least_slope: added to every slope, so that the angle strictly rises.
        folds: greatest number of groups of trials in the comparison, each left out once.
    """

    name: str = "best"
    plays: Count = 12
    reach: Annotated[float, Field(gt=0, le=1)] = 0.45
    inverse_reach: Annotated[float, Field(gt=0, le=1)] = 0.45
    inverse_finest: Annotated[float, Field(gt=0, le=1)] = 3e-4
    segments: Count = 14
    lags_s: tuple[NotNegative, ...] = Field(default=(0.0, 0.02, 0.04, 0.06), min_length=1)
    smoothness: tuple[NotNegative, ...] = Field(default=(3e-7, 3e-6, 3e-5), min_length=1)
    offset_penalty: NotNegative = 0.03
    least_slope: Positive = 1e-6
    folds: Annotated[int, Field(ge=2)] = 6


PLAY_KERNEL_TRAININGS: Mapping[str, PlayKernelSettings] = {
    "best": PlayKernelSettings(),
    "rate_independent": PlayKernelSettings(name="rate_independent", lags_s=(0.0,)),
}
_JITTER = 1e-10
_SOON = 500_000  # samples below which a fit takes seconds and is not announced


@dataclass(frozen=True)
class Regularisation:
    """Time constant of the lag [s] and penalty on differences of slopes, as compared on held-out trials."""

    lag_s: float
    smoothness: float


@dataclass(frozen=True, eq=False)
class PlayKernelFit:
    """Identified play-kernel model.

    Attributes:
        choice: lag and smoothness with the least held-out error.
        judged: mean offset-free error on held-out trials [unit of the output] of every choice compared; empty where
            there was nothing to compare.
        rmse: mean over the training trials of the error without their offsets [unit of the output].
    """

    weights: PlayKernelWeights
    choice: Regularisation
    judged: dict[Regularisation, float]
    rmse: float
    interrupted: bool


def fit_play_kernel(
    trials: Sequence[Trial],
    settings: PlayKernelSettings | None = None,
    skip_first_flexure: bool = False,
    progress: FitProgress | None = None,
) -> PlayKernelFit:
    """Identify a play-kernel model; every trial has equal weight and a separate offset.

        min  mean_trials mean_t (theta - model(u) - b_trial)^2 + p sum b_trial^2 + q sum (s - s_neighbour)^2,  s >= 0

    Neighbours are the next segment of the same play and the same segment of the next play. Lag and q have the least
    offset-free error on held-out groups of whole trials.

    Args:
        trials: uniformly sampled at one rate, in one unit; swapped ones give an inverse map, which has stops too.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: called with the fits so far and the least error on held-out trials; KeyboardInterrupt keeps the best.

    Raises:
        FitError: on unusable trials, an angle that falls with the command, or a least-squares problem not solved.
    """
    settings = settings or PlayKernelSettings()
    frame = _frame(trials, settings)
    _line(trials)
    starts = [first_flexure_end(trial) if skip_first_flexure else 0 for trial in trials]
    choices = [Regularisation(*pair) for pair in itertools.product(settings.lags_s, settings.smoothness)]
    judged: dict[Regularisation, float] = {}
    interrupted, chosen = False, choices[len(choices) // 2]
    if len(trials) > 1 and len(choices) > 1:
        try:
            for lag_s in settings.lags_s:
                courses = [Course(*pair, frame, lag_s) for pair in zip(trials, starts, strict=True)]
                for choice, error in _left_out(courses, lag_s, frame, settings):
                    judged[choice] = error * span(frame.angle)
                    if progress:
                        progress(len(judged), min(judged.values()))
        except KeyboardInterrupt:
            interrupted = True
        chosen = min(judged, key=lambda c: judged[c], default=chosen)
    courses = [Course(*pair, frame, chosen.lag_s) for pair in zip(trials, starts, strict=True)]
    slopes, bias = _solve([course.moments for course in courses], chosen, frame, settings)
    rmse = float(np.mean([course.scatter(slopes[:, None])[0] for course in courses])) * span(frame.angle)
    if progress:
        progress(len(judged) + 1, min(judged.values(), default=rmse))
    return PlayKernelFit(_weights(slopes, bias, trials, chosen, frame), chosen, judged, rmse, interrupted)


def play_kernel_seconds(trials: Sequence[Trial], settings: PlayKernelSettings) -> float | None:
    """Expected duration of a fit [s], measured on one block; None for a short fit.

    Raises:
        FitError: on unusable trials.
    """
    frame, samples = _frame(trials, settings), sum(len(trial) for trial in trials)
    if samples < _SOON:
        return None
    head = trials[0].select(0, BLOCK)
    _ = Course(head, 0, frame, 0.0).moments  # what is loaded once is no part of the time
    start = time.perf_counter()
    course = Course(head, 0, frame, max(settings.lags_s))
    course.scatter(np.zeros((course.moments.mean.size, len(settings.smoothness))))
    return (time.perf_counter() - start) / len(head) * samples * (len(settings.lags_s) + 1)


_SETTLED_LAGS = 20.0  # time constants after which a step has settled


def play_kernel_bundle(
    fit: PlayKernelFit, trials: Sequence[Trial], settings: PlayKernelSettings, limits: DeviceLimits
) -> ExportBundle:
    """Exportable bundle of a play-kernel model: graph, metadata, reference and probe.

    A fresh device rests at the first command of a trial, with no play in contact; a conditioned one has been flexed to
    the greatest trained command and back. The first command is held until the lag has settled.

    Raises:
        FitError: on unusable trials.
    """
    weights = fit.weights
    step = PlayKernelStep(weights)
    warmup = max(1, math.ceil(_SETTLED_LAGS * fit.choice.lag_s / check_trial_set(trials)))
    rest = float(np.mean([trial.command[0] for trial in trials]))
    fresh = np.full(weights.state_size, rest)
    moved = {"by_command": (1.0,) * fresh.size, "at_command": rest}
    metadata = facts_of(
        "play_kernel",
        trials,
        limits,
        (
            fixed_rule(fresh).model_copy(update=moved),
            fixed_rule(flexed(step, fresh, command_range(trials), check_trial_set(trials), warmup)),
        ),
        warmup,
        {
            "preset": settings.name,
            "settings": settings.model_dump_json(),
            "lag_s": fit.choice.lag_s,
            "smoothness": fit.choice.smoothness,
            "training_rmse": fit.rmse,
            "interrupted": fit.interrupted,
        },
    )
    return ExportBundle(play_kernel_graph(weights), metadata, step, probe_commands(metadata))


BLOCK = 16_384
"""Samples whose features are held at once, 25 MB."""


@dataclass(frozen=True)
class Frame:
    """Scales of commands and angles, radii and knots of the features.

    Attributes:
        command, angle: trained ranges [cmd], [deg].
        radii, knots: of plays and ramps, in units of the command range.
        stops: whether the difference of command and play is a feature, too.
        dt: sample interval [s].
    """

    command: Range
    angle: Range
    radii: Vec
    knots: Vec
    stops: bool
    dt: float

    def gain(self, lag_s: float) -> float:
        """Gain of one sample of a lag with this time constant [s]."""
        return 1.0 if lag_s == 0 else 1 - math.exp(-self.dt / lag_s)


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean products of one trial's features (F,) with each other and with its scaled angle, as a fit needs them."""

    gram: Vec
    mean: Vec
    right: Vec
    angle: float


@final
class Course:
    """Features of one trial, in blocks of samples: all features of five million samples would need 8 GB."""

    def __init__(self, trial: Trial, start: int, frame: Frame, lag_s: float) -> None:
        self._trial, self._start, self._frame, self._gain = trial, start, frame, frame.gain(lag_s)

    def blocks(self) -> Iterator[tuple[Vec, Vec]]:
        """Features (T, F) and scaled angle (T,) of the samples that count; the plays run from rest over all samples."""
        trial, frame = self._trial, self._frame
        state = np.full(frame.radii.size + 1, scaled(trial.command[0], frame.command))
        for first in range(0, len(trial), BLOCK):
            block = slice(first, first + BLOCK)
            states = follow_plays(scaled(trial.command[block], frame.command), self._gain, frame.radii, state)
            state, cut = states[-1].copy(), max(self._start - first, 0)
            if cut < len(states):
                yield self._features(states[cut:]), scaled(trial.angle[block], frame.angle)[cut:]

    @cached_property
    def moments(self) -> Moments:
        """Combined moments of all blocks."""
        count, angle = 0, 0.0
        gram, mean, right = (np.zeros(()) for _ in range(3))
        for x, y in self.blocks():
            count, angle = count + y.size, angle + float(y.sum())
            gram, mean, right = gram + x.T @ x, mean + x.sum(axis=0), right + x.T @ y
        return Moments(gram / count, mean / count, right / count, angle / count)

    def scatter(self, slopes: Vec) -> Vec:
        """Standard deviation (S,) of the errors of models with slopes (F, S), each with a free offset."""
        count, mean, square = 0, np.zeros(slopes.shape[1]), np.zeros(slopes.shape[1])
        for x, y in self.blocks():
            errors = x @ slopes - y[:, None]
            trial_mean = errors.mean(axis=0)
            share = y.size / (count + y.size)  # joined as in Chan, Golub, LeVeque, Amer. Statist. 37 (1983)
            square += np.sum((errors - trial_mean) ** 2, axis=0) + count * share * (trial_mean - mean) ** 2
            mean, count = mean + share * (trial_mean - mean), count + y.size
        return np.asarray(np.sqrt(square / count), dtype=np.float64)

    def _features(self, states: Vec) -> Vec:
        features = ramps(states, self._frame.knots).reshape(len(states), -1)
        if not self._frame.stops:
            return features
        stop = states[:, :1] - states[:, 1:]
        return np.hstack([features, np.minimum(stop, 0.0), np.maximum(stop, 0.0)])


def scaled(values: Any, bounds: Range) -> Any:
    """Values in units of a range, 0 at its lower end."""
    return (values - bounds.lower) / span(bounds)


def span(bounds: Range) -> float:
    """Width of a range."""
    return bounds.upper - bounds.lower


def _frame(trials: Sequence[Trial], settings: PlayKernelSettings) -> Frame:
    dt, inverse = check_trial_set(trials), trials[0].inverted
    n = settings.plays
    if inverse:
        radii = np.geomspace(settings.inverse_finest, settings.inverse_reach, n)
    else:
        radii = np.linspace(0.0, settings.reach, n + 1)[1:]
    knots = np.linspace(0.0, 1.0, settings.segments + 1)
    return Frame(command_range(trials), angle_range(trials), radii, knots, inverse, dt)


def _left_out(
    courses: Sequence[Course], lag_s: float, frame: Frame, settings: PlayKernelSettings
) -> Iterator[tuple[Regularisation, float]]:
    """Mean over trials of the scaled offset-free error on held-out trials, by choice."""
    choices = [Regularisation(lag_s, smoothness) for smoothness in settings.smoothness]
    moments = [course.moments for course in courses]
    count = min(settings.folds, len(courses))
    errors = np.empty((len(courses), len(choices)))
    for fold in range(count):
        rest = [m for k, m in enumerate(moments) if k % count != fold]
        slopes = np.stack([_solve(rest, choice, frame, settings)[0] for choice in choices], axis=1)
        for k in range(fold, len(courses), count):
            errors[k] = courses[k].scatter(slopes)
    yield from zip(choices, errors.mean(axis=0).tolist(), strict=True)


def _solve(
    rows: Sequence[Moments], choice: Regularisation, frame: Frame, settings: PlayKernelSettings
) -> tuple[Vec, float]:
    """Scaled slopes (F,) and bias by non-negative least squares on the Cholesky factor of the normal equations."""
    count, trials = rows[0].mean.size, len(rows)
    free = 1 + trials
    gram, right = np.zeros((count + free, count + free)), np.zeros(count + free)
    for k, row in enumerate(rows):
        shown = [count, count + 1 + k]  # bias and offset of the trial
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
        weights, _ = nnls(factor.T, np.linalg.solve(factor, right), maxiter=50 * len(gram))
    except RuntimeError as error:
        raise FitError(f"play kernel: non-negative least squares of {len(gram)} unknowns: {error}") from None
    return weights[:count] + settings.least_slope, float(weights[count] - weights[count + free])


def _roughness(frame: Frame) -> NDArray[Any]:
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


def _weights(
    slopes: Vec, bias: float, trials: Sequence[Trial], choice: Regularisation, frame: Frame
) -> PlayKernelWeights:
    plays, segments = frame.radii.size + 1, frame.knots.size - 1
    command, angle = span(frame.command), span(frame.angle)
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
    """Slope of the regression line through all samples [deg/cmd]; an error if it does not rise."""
    samples = sum(len(trial) for trial in trials)
    middle = sum(float(t.command.sum()) for t in trials) / samples, sum(float(t.angle.sum()) for t in trials) / samples
    products = sum(float((t.command - middle[0]) @ (t.angle - middle[1])) for t in trials)
    slope = products / sum(float(np.sum((t.command - middle[0]) ** 2)) for t in trials)
    if slope <= 0:
        units = trials[0].units
        raise falls(f"({slope:.4g} {units.angle} per {units.command})", units.angle)
    return slope


@final
class PlayKernelKind(ModelKind):
    """Monotone additive regression on plays: `best` with a lag in front, or `rate_independent`."""

    name = "play_kernel"
    title = "play kernel"
    trainings = ("best", "rate_independent")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        settings = PLAY_KERNEL_TRAININGS[request.training]
        history, show = recorded(progress)
        fit = fit_play_kernel(trials, settings, request.skip_first_flexure, show)
        unit = trials[0].units.angle
        report = f"lag {fit.choice.lag_s:g} s, {fit.rmse:.4g} {unit} on the training trials"
        if fit.judged:
            report += f", {fit.judged[fit.choice]:.4g} {unit} offset-free on trials left out"
        bundle = with_noise(play_kernel_bundle(fit, trials, settings, request.limits), trials, fit.weights.state_size)
        return Identified(bundle, None, tuple(history), report, fit.interrupted)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return play_kernel_seconds(trials, PLAY_KERNEL_TRAININGS[request.training])

    def steps(self, request: FitRequest) -> int | None:
        settings = PLAY_KERNEL_TRAININGS.get(request.training)
        return None if settings is None else len(settings.lags_s) * len(settings.smoothness) + 1
