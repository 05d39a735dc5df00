"""Training of any network on recorded trials, its model file, and its expected duration."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.errors import FitError, FitInterruptedError
from hystmpc.trials.trial import Trial

from ..contract.export import TOLERANCE_DEG, ExportBundle
from ..contract.metadata import DeviceLimits, InitialRule, Range
from ..decades import Decades
from ..identify.runs import check_trial_set, command_range, facts_of
from ..model import FitProgress
from ..motions import initialisation_flexure, probe_commands
from ..networks.nodes import Scaling, network_step_graph
from ..networks.settings import DeviceFacts, NetworkSettings, StreamTraining, WindowTraining
from .runs import Rng, TrainingRun, hold_out, prepared, rest_of, scaled_run, scaling_of
from .teacher import Teacher

if TYPE_CHECKING:
    from ..networks.network_ import Network, TorchStep
    from .updates_ import Check, TeacherRuns


@dataclass(frozen=True)
class NetworkCheck:
    """Errors at one check during training.

    Attributes:
        training_rmse_deg: error in training, the teacher's runs included [deg; of an inverse map in its unit].
        validation_rmse_deg: error on held-out trials [deg].
        rounding_deg: effect of single precision on free runs over held-out trials [deg].
        allowed_deg: its limit: half of the export's tolerance for a device of this size [deg].
    """

    step: int
    training_rmse_deg: float
    validation_rmse_deg: float
    rounding_deg: float
    allowed_deg: float = 0.5 * TOLERANCE_DEG

    @property
    def exportable(self) -> bool:
        """Whether a free run in single precision stays well within the tolerance of the export."""
        return self.rounding_deg <= self.allowed_deg


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """Result of a training.

    Attributes:
        net: network with the lowest validation error among the exportable checks.
        best_step: epoch or update of `net`.
        validation_rmse_deg: its error on the held-out trials [deg]; on the training trials where none is held out.
    """

    net: Network
    scaling: Scaling
    settings: NetworkSettings
    history: tuple[NetworkCheck, ...]
    best_step: int
    validation_rmse_deg: float
    held_out: tuple[str, ...]
    interrupted: bool = False


def fit_network(
    trials: Sequence[Trial],
    settings: NetworkSettings | None = None,
    progress: FitProgress | None = None,
    validation: Sequence[Trial] = (),
) -> NetworkFit:
    """Train a network and return the weights with the lowest held-out error; reproducible on the same machine.

    Args:
        trials: uniformly sampled at one rate, in one pair of units, each from its start; swapped ones for an inverse.
        settings: see `NetworkSettings` and `kinds.networks`; an LSTM where left out.
        progress: called at every check with the epochs or updates so far, of `settings.steps`, and the best validation
            error [deg]; KeyboardInterrupt ends the training and keeps the best so far.
        validation: trials that only judge, beside those held out of `trials`.

    Raises:
        FitError: on unusable trials, if too few are left to train on, if the loss diverges, if training is interrupted
            before the first check, or if torch is not installed.
    """
    settings = settings or NetworkSettings()
    check_trial_set([*trials, *validation])
    training, held_out = hold_out(trials, settings.validation_trials, settings.seed)
    held_out += validation
    scaling = scaling_of(trials, settings.scaling)
    history: list[NetworkCheck] = []
    best: tuple[NetworkCheck, Network] | None = None
    interrupted = False
    try:
        for look, net in _looks(training, held_out or training, scaling, settings):
            history.append(look)
            if look.exportable and (best is None or _better(look, best[0], settings)):
                best = look, copy.deepcopy(net)
            if progress:
                progress(look.step, best[0].validation_rmse_deg if best else math.inf)
    except KeyboardInterrupt:
        interrupted = True
    if best is None:
        kind = FitInterruptedError if interrupted else FitError
        raise kind(_nothing_to_keep(history, trials[0].units.angle))
    sources = tuple(trial.source for trial in held_out)
    chosen, net = best
    return NetworkFit(
        net, scaling, settings, tuple(history), chosen.step, chosen.validation_rmse_deg, sources, interrupted
    )


def _better(look: NetworkCheck, best: NetworkCheck, settings: NetworkSettings) -> bool:
    early = 0 if isinstance(settings.training, StreamTraining) else settings.training.keep_after
    if best.step <= early < look.step:
        return True
    return look.validation_rmse_deg < best.validation_rmse_deg


def _nothing_to_keep(history: Sequence[NetworkCheck], unit: str) -> str:
    if not history:
        return "training was interrupted before its first check, there is nothing to keep"
    least = min(look.rounding_deg for look in history)
    return (
        f"the network amplifies rounding: single and double precision differ by at least {least:.2g} {unit} in all "
        f"{len(history)} checks, expected at most {history[0].allowed_deg:g}; another seed or a lower "
        "learning_rate helps"
    )


def _looks(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: Scaling, settings: NetworkSettings
) -> Iterator[tuple[NetworkCheck, Network]]:
    allowed = 0.5 * TOLERANCE_DEG * Decades.of(training).output(training)
    with _torch(settings):
        for check in _checks(training, judges, scaling, settings):
            training_rmse, judged, rounding = (
                scaling.theta_scale * part for part in (check.training, check.judged, check.rounding)
            )
            if not math.isfinite(judged):
                raise FitError(f"training diverged: free run not finite at step {check.step}; lower learning_rate")
            yield NetworkCheck(check.step, training_rmse, judged, rounding, allowed), check.net


def _torch(settings: NetworkSettings) -> AbstractContextManager[None]:
    try:
        from .updates_ import torch_session
    except ModuleNotFoundError as error:
        raise FitError(f"training needs {error.name}, expected it installed: pip install hystmpc[train]") from None
    return torch_session(settings.seed, settings.threads)


def _checks(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: Scaling, settings: NetworkSettings
) -> Iterator[Check]:
    from .updates_ import stream_checks, window_checks

    scheme = settings.training
    teacher, lag_s = None, 0.0
    if isinstance(scheme, StreamTraining) and scheme.teacher is not None:
        teacher = Teacher(training, scheme.teacher.plays, scheme.teacher.model)
        lag_s = teacher.lag_s
        if scheme.teacher.centred:
            shared = judges is training
            training = [teacher.centred(trial) for trial in training]
            judges = training if shared else judges
    operator = settings.network.operator(training, scaling, settings.first_flexure_weight == 0.0)
    rest, inverted = rest_of(training, scaling, settings.rest), training[0].inverted
    net = settings.network.network(DeviceFacts(rest, operator, lag_s / training[0].dt, inverted))
    runs, held_out = (prepared(trials, scaling, settings) for trials in (training, judges))
    if isinstance(scheme, StreamTraining):
        return stream_checks(net, runs, held_out, _teacher_runs(teacher, scaling, scheme), settings, scheme)
    return window_checks(net, runs, held_out, settings, scheme)


def _teacher_runs(teacher: Teacher | None, scaling: Scaling, scheme: StreamTraining) -> TeacherRuns:
    if teacher is None or scheme.teacher is None:
        return lambda done, rng: []
    count, (first, last) = scheme.teacher.runs, scheme.teacher.weight

    def runs(done: float, rng: Rng) -> list[TrainingRun]:
        return [scaled_run(run, scaling) for run in teacher.runs(count, first + (last - first) * done, rng)]

    return runs


def network_bundle(fit: NetworkFit, trials: Sequence[Trial], limits: DeviceLimits | None = None) -> ExportBundle:
    """Exportable bundle of a trained network: graph, metadata, reference and probe.

    Args:
        trials: its trials, held-out ones included, for ranges and fingerprint.
        limits: limits of the command; the range in the trials where left out.

    Raises:
        FitError: on unusable trials.
        ModelError: if they are beyond the bounds of a model file.
    """
    from ..networks.network_ import TorchStep  # torch is there: the network was trained with it

    step = TorchStep(fit.net, fit.scaling)
    dt, trained, warmup = check_trial_set(trials), command_range(trials), fit.settings.warmup_samples
    rest = float(np.median([trial.angle[0] for trial in trials]))
    metadata = facts_of(
        fit.settings.kind,
        trials,
        limits or DeviceLimits(),
        (step.initial_rule(), _conditioned_rule(step, trained, rest, dt, warmup)),
        warmup,
        {
            "preset": fit.settings.name,
            "settings": fit.settings.model_dump_json(),
            "best_step": fit.best_step,
            "validation_rmse_deg": fit.validation_rmse_deg,
            "interrupted": fit.interrupted,
            "held_out": ", ".join(Path(source).name for source in fit.held_out),
        },
    )
    graph = network_step_graph(f"{fit.settings.kind}_step", fit.net.state_size, fit.scaling, fit.net.write)
    return ExportBundle(graph, metadata, step, probe_commands(metadata))


def _conditioned_rule(step: TorchStep, trained: Range, rest: float, dt_s: float, warmup: int) -> InitialRule:
    """Initial rule after the initialisation flexure from rest at angle `rest`; measured entries start as in a trial."""
    initial = step.initial_rule()
    start = initial.state(np.array([[rest]]))[0]
    _, state = step.run(start, initialisation_flexure(trained, dt_s, warmup))
    known = np.arange(step.state_size) >= step.state_size - step.measured
    offset, slope = np.where(known, initial.offset, state), np.where(known, initial.slope, 0.0)
    return InitialRule(offset=tuple(offset.tolist()), slope=tuple(slope.tolist()))


_FIRST, _TIMED = 3, 12


def training_seconds(trials: Sequence[Trial], settings: NetworkSettings) -> float:
    """Expected duration of the updates of `fit_network` [s] on this machine at its present load.

    Raises:
        FitError: on unusable trials, if too few are left to train on, or if torch is not installed.
    """
    check_trial_set(trials)
    training, _ = hold_out(trials, settings.validation_trials, settings.seed)
    with _torch(settings):
        net = settings.network.network(DeviceFacts(inverted=trials[0].inverted))
        scheme = settings.training
        if isinstance(scheme, StreamTraining):
            return scheme.updates * _seconds_of(_stream_update(net, settings, scheme))
        count = scheme.windows_per_epoch or sum(len(trial) + scheme.padding_samples for trial in training)
        return scheme.epochs * math.ceil(count / scheme.batch) * _seconds_of(_window_update(net, settings, scheme))


def _seconds_of(improve: Callable[[], object]) -> float:
    durations = []
    for _ in range(_FIRST + _TIMED):
        before = time.perf_counter()
        improve()
        durations.append(time.perf_counter() - before)
    return float(np.median(durations[_FIRST:]))


def _window_update(net: Network, settings: NetworkSettings, scheme: WindowTraining) -> Callable[[], object]:
    from .updates_ import cut, window_update

    rng, improve = np.random.default_rng(0), window_update(net, settings, scheme)
    parts = [rng.uniform(-1, 1, (scheme.batch, net.context + scheme.length)).astype(np.float32) for _ in range(4)]
    return lambda: improve(cut(net, parts), 0)


def _stream_update(net: Network, settings: NetworkSettings, scheme: StreamTraining) -> Callable[[], object]:
    import torch

    from .updates_ import Piece, stream_update

    improve = stream_update(net, settings, scheme)
    signal = torch.rand(scheme.streams, scheme.length)
    piece = Piece(signal, signal, torch.ones_like(signal), torch.ones(scheme.streams, 1, dtype=torch.bool))
    return lambda: improve(piece, None, 0)
