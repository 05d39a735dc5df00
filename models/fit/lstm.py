"""Training of an LSTM on recorded trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial

from ..contract.gate import TOLERANCE_DEG
from ..lstm.weights import LstmScaling, LstmWeights
from .lstm_settings import LstmSettings, StreamTraining
from .lstm_teacher import Teacher
from .split import hold_out
from .streams import Rng, Run
from .trial_set import angle_range, check_trial_set, command_range

if TYPE_CHECKING:
    from .lstm_torch_ import Check, TeacherRuns

Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class LstmCheck:
    """One look during training.

    Attributes:
        step: epochs or updates done.
        training_rmse_deg: error in training, the teacher's runs included [deg].
        validation_rmse_deg: error on what is held out [deg].
        rounding_deg: what single precision does to a free run over what is held out [deg].
    """

    step: int
    training_rmse_deg: float
    validation_rmse_deg: float
    rounding_deg: float

    @property
    def exportable(self) -> bool:
        """Whether a free run in single precision stays well within the tolerance of the export."""
        return self.rounding_deg <= 0.5 * TOLERANCE_DEG


@dataclass(frozen=True)
class LstmFit:
    """Result of a training.

    Attributes:
        weights: those with the lowest validation error among the exportable ones.
        settings: what it was trained with.
        history: every look.
        best_step: epoch or update of `weights`.
        validation_rmse_deg: their error on the held-out trials [deg]; on the training trials where none is held out.
        held_out: sources of the held-out trials.
        interrupted: stopped by the user; `weights` are the best so far.
    """

    weights: LstmWeights
    settings: LstmSettings
    history: tuple[LstmCheck, ...]
    best_step: int
    validation_rmse_deg: float
    held_out: tuple[str, ...]
    interrupted: bool = False


def fit_lstm(
    trials: Sequence[Trial],
    settings: LstmSettings | None = None,
    progress: Progress | None = None,
    validation: Sequence[Trial] = (),
) -> LstmFit:
    """Train an LSTM; the weights that do best on held-out trials are kept. Same trials, settings, machine: same result.

    Args:
        trials: uniformly sampled at one rate, in one unit, each from its start.
        settings: see `LstmSettings`; `LSTM_PRESETS` has two.
        progress: called at every look with the epochs or updates so far, of `settings.steps`, and the best validation
            error [deg]; KeyboardInterrupt ends the training and keeps the best so far.
        validation: trials that only judge, beside those held out of `trials`.

    Raises:
        FitError: on unusable trials, if too few are left to train on, if the loss diverges, if training is
            interrupted before the first look, or if torch is not installed.
    """
    settings = settings or LstmSettings()
    check_trial_set([*trials, *validation])
    training, held_out = hold_out(trials, settings.validation_trials, settings.seed)
    held_out += validation
    scaling = lstm_scaling(trials, settings)
    history: list[LstmCheck] = []
    best: tuple[LstmCheck, LstmWeights] | None = None
    interrupted = False
    try:
        for look, weights in _looks(training, held_out or training, scaling, settings):
            history.append(look)
            if look.exportable and (best is None or look.validation_rmse_deg < best[0].validation_rmse_deg):
                best = look, weights
            if progress:
                progress(look.step, best[0].validation_rmse_deg if best else math.inf)
    except KeyboardInterrupt:
        interrupted = True
    if best is None:
        raise FitError(_nothing_to_keep(history))
    sources = tuple(trial.source for trial in held_out)
    chosen, weights = best
    return LstmFit(weights, settings, tuple(history), chosen.step, chosen.validation_rmse_deg, sources, interrupted)


def _nothing_to_keep(history: Sequence[LstmCheck]) -> str:
    if not history:
        return "training was interrupted before its first check, there is nothing to keep"
    least = min(look.rounding_deg for look in history)
    return (
        f"the network amplifies rounding: single and double precision differ by at least {least:.2g} deg in all "
        f"{len(history)} checks, expected at most {0.5 * TOLERANCE_DEG:g}; another seed or a lower learning_rate helps"
    )


def lstm_scaling(trials: Sequence[Trial], settings: LstmSettings) -> LstmScaling:
    """Scaling of the settings, else the one that maps the trials' ranges to [-1, 1]."""
    if settings.scaling is not None:
        return LstmScaling(**settings.scaling.model_dump())
    u, theta = command_range(trials), angle_range(trials)
    numbers = [(0.5 * (r.lower + r.upper), 0.5 * (r.upper - r.lower)) for r in (u, theta)]
    # Single precision, as the graph will hold them: what was trained is what is exported.
    return LstmScaling(*(float(np.float32(number)) for pair in numbers for number in pair))


def _looks(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: LstmScaling, settings: LstmSettings
) -> Iterator[tuple[LstmCheck, LstmWeights]]:
    try:
        from ..lstm.torch_ import weights_of
        from .lstm_torch_ import new_net, stream_checks, torch_session, window_checks
    except ModuleNotFoundError as error:
        raise FitError(f"training needs {error.name}, expected it installed: pip install hystmpc[train]") from None
    runs = [_run(trial, scaling, settings) for trial in training]
    judged = [_run(trial, scaling, settings) for trial in judges]
    way = settings.training
    with torch_session(settings.seed, settings.threads):
        net = new_net(settings)
        checks: Iterator[Check]
        if isinstance(way, StreamTraining):
            checks = stream_checks(net, runs, judged, _teacher(training, scaling, way), settings, way)
        else:
            checks = window_checks(net, runs, judged, settings, way)
        for check in checks:
            in_degrees = tuple(scaling.theta_scale * part for part in (check.training, check.judged, check.rounding))
            if not math.isfinite(in_degrees[1]):
                raise FitError(f"training diverged: free run not finite at step {check.step}; lower learning_rate")
            yield LstmCheck(check.step, *in_degrees), weights_of(check.net, scaling)


def _teacher(training: Sequence[Trial], scaling: LstmScaling, way: StreamTraining) -> TeacherRuns:
    if way.teacher is None:
        return lambda done, rng: []
    teacher, count = Teacher(training, way.teacher.plays), way.teacher.runs
    first, last = way.teacher.weight

    def runs(done: float, rng: Rng) -> list[Run]:
        return [_scaled(run, scaling) for run in teacher.runs(count, first + (last - first) * done, rng)]

    return runs


def _run(trial: Trial, scaling: LstmScaling, settings: LstmSettings) -> Run:
    weight = np.ones(len(trial))
    if settings.first_flexure_weight != 1.0:
        weight[: first_flexure_end(trial)] = settings.first_flexure_weight
    return _scaled(Run(trial.command, trial.angle, weight), scaling)


def _scaled(run: Run, scaling: LstmScaling) -> Run:
    command = (run.command - scaling.u_offset) / scaling.u_scale
    return Run(command, (run.angle - scaling.theta_offset) / scaling.theta_scale, run.weight)
