"""Training of any network on recorded trials."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from ..contract.gate import TOLERANCE_DEG
from ..identify.trial_set import check_trial_set
from ..networks.scaling import Scaling
from ..train.hold_out import hold_out
from .network_runs import Prepared, prepared, rest_of, scaled_run, scaling_of
from .network_settings import NetworkSettings, StreamTraining
from .streams import Rng, Run
from .teacher import Teacher

if TYPE_CHECKING:
    from ..networks.network_ import Network
    from .streams_torch_ import TeacherRuns
    from .training_torch_ import Check

Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class NetworkCheck:
    """One look during training.

    Attributes:
        step: epochs or updates done.
        training_rmse_deg: error in training, the teacher's runs included [deg; of an inverse map in its unit].
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


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """Result of a training.

    Attributes:
        net: with the lowest validation error among the exportable looks.
        scaling: units around it.
        settings: what it was trained with.
        history: every look.
        best_step: epoch or update of `net`.
        validation_rmse_deg: its error on the held-out trials [deg]; on the training trials where none is held out.
        held_out: sources of the held-out trials.
        interrupted: stopped by the user; `net` is the best so far.
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
    progress: Progress | None = None,
    validation: Sequence[Trial] = (),
) -> NetworkFit:
    """Train a network; the weights that do best on held-out trials are kept. Same trials, settings, machine: same net.

    Args:
        trials: uniformly sampled at one rate, in one pair of units, each from its start; swapped ones for an inverse.
        settings: see `NetworkSettings` and `NETWORK_PRESETS`; an LSTM where left out.
        progress: called at every look with the epochs or updates so far, of `settings.steps`, and the best validation
            error [deg]; KeyboardInterrupt ends the training and keeps the best so far.
        validation: trials that only judge, beside those held out of `trials`.

    Raises:
        FitError: on unusable trials, if too few are left to train on, if the loss diverges, if training is
            interrupted before the first look, or if torch is not installed.
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
        raise FitError(_nothing_to_keep(history))
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


def _nothing_to_keep(history: Sequence[NetworkCheck]) -> str:
    if not history:
        return "training was interrupted before its first check, there is nothing to keep"
    least = min(look.rounding_deg for look in history)
    return (
        f"the network amplifies rounding: single and double precision differ by at least {least:.2g} deg in all "
        f"{len(history)} checks, expected at most {0.5 * TOLERANCE_DEG:g}; another seed or a lower learning_rate helps"
    )


def _looks(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: Scaling, settings: NetworkSettings
) -> Iterator[tuple[NetworkCheck, Network]]:
    try:
        from .training_torch_ import torch_session
    except ModuleNotFoundError as error:
        raise FitError(f"training needs {error.name}, expected it installed: pip install hystmpc[train]") from None
    with torch_session(settings.seed, settings.threads):
        for check in _checks(training, judges, scaling, settings):
            in_degrees = tuple(scaling.theta_scale * part for part in (check.training, check.judged, check.rounding))
            if not math.isfinite(in_degrees[1]):
                raise FitError(f"training diverged: free run not finite at step {check.step}; lower learning_rate")
            yield NetworkCheck(check.step, *in_degrees), check.net


def _checks(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: Scaling, settings: NetworkSettings
) -> Iterator[Check]:
    from ..networks.build_ import new_network
    from .streams_torch_ import stream_checks
    from .windows_torch_ import window_checks

    ready: Prepared = prepared(training, judges, scaling, settings)
    net = new_network(settings.network, rest_of(training, scaling, settings.rest), ready.operator)
    way = settings.training
    if isinstance(way, StreamTraining):
        return stream_checks(net, ready.training, ready.judges, _teacher(training, scaling, way), settings, way)
    return window_checks(net, ready.training, ready.judges, settings, way)


def _teacher(training: Sequence[Trial], scaling: Scaling, way: StreamTraining) -> TeacherRuns:
    if way.teacher is None:
        return lambda done, rng: []
    teacher, count = Teacher(training, way.teacher.plays, way.teacher.model), way.teacher.runs
    first, last = way.teacher.weight

    def runs(done: float, rng: Rng) -> list[Run]:
        return [scaled_run(run, scaling) for run in teacher.runs(count, first + (last - first) * done, rng)]

    return runs
