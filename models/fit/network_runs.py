"""From trials to what a network is trained on: scaled runs, rest before them, and the backlash of a hybrid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial

from ..identify.trial_set import angle_range, command_range
from ..networks.scaling import Scaling
from ..networks.settings import FeedForwardSettings, HybridSettings
from ..operators.operator import Operator
from .network_operator import fitted_backlash, scaled_operator
from .network_settings import NetworkSettings, RestSettings, ScalingSettings, WindowTraining
from .streams import Run


@dataclass(frozen=True)
class Prepared:
    """Scaled runs and, for a hybrid, the fitted operator in scaled units."""

    training: list[Run]
    judges: list[Run]
    operator: Operator | None


def prepared(
    training: Sequence[Trial], judges: Sequence[Trial], scaling: Scaling, settings: NetworkSettings
) -> Prepared:
    """Scale and pad the trials; fit the backlash of a hybrid to those that are trained on.

    Raises:
        FitError: if the backlash cannot be fitted.
    """
    runs = [[_run(trial, scaling, settings) for trial in trials] for trials in (training, judges)]
    form = settings.network
    if not isinstance(form, HybridSettings):
        return Prepared(runs[0], runs[1], None)
    backlash = fitted_backlash(training, settings.first_flexure_weight == 0.0, form.dead_zone)
    return Prepared(runs[0], runs[1], scaled_operator(backlash, scaling))


def scaling_of(trials: Sequence[Trial], given: ScalingSettings | None) -> Scaling:
    """The given scaling for devices of its unit, else the one that maps the trials' ranges to [-1, 1]."""
    inverted = trials[0].inverted
    if given is not None and _command_unit(trials[0]) == given.unit:
        command, angle = (given.command_offset, given.command_scale), (given.angle_offset, given.angle_scale)
        return Scaling(*angle, *command) if inverted else Scaling(*command, *angle)
    u, theta = command_range(trials), angle_range(trials)
    pairs = [(0.5 * (r.lower + r.upper), 0.5 * (r.upper - r.lower)) for r in (u, theta)]
    # Single precision, as the graph will hold them: what was trained is what is exported.
    return Scaling(*(float(np.float32(number)) for pair in pairs for number in pair))


def rest_of(trials: Sequence[Trial], scaling: Scaling, given: RestSettings | None) -> float:
    """Scaled input of a device at rest: as given for devices of that unit, else the least input of the trials."""
    if given is not None and _command_unit(trials[0]) == given.unit:
        rest = given.angle if trials[0].inverted else given.command
    else:
        rest = command_range(trials).lower
    return float(scaling.scale_in(np.array(rest)))


def scaled_run(run: Run, scaling: Scaling) -> Run:
    """The same motion in scaled units."""
    return Run(scaling.scale_in(run.command), scaling.scale_out(run.angle), run.weight)


def _run(trial: Trial, scaling: Scaling, settings: NetworkSettings) -> Run:
    weight = np.ones(len(trial))
    if settings.first_flexure_weight != 1.0:
        weight[: first_flexure_end(trial)] = settings.first_flexure_weight
    run = Run(trial.command, trial.angle, weight)
    if isinstance(settings.training, WindowTraining):
        run = _padded(run, trial, settings, settings.training)
    return scaled_run(run, scaling)


def _padded(run: Run, trial: Trial, settings: NetworkSettings, way: WindowTraining) -> Run:
    """Rest before the trial; a network that looks back needs at least as much as it looks back on."""
    form = settings.network
    context = form.history - 1 if isinstance(form, FeedForwardSettings) else 0
    command, angle = float(trial.command[0]), float(trial.angle[0])
    if settings.rest is not None and _command_unit(trial) == settings.rest.unit:
        rest = (settings.rest.command, settings.rest.angle)
        command, angle = rest[::-1] if trial.inverted else rest
    scored = settings.first_flexure_weight if way.padding_samples else 0.0
    return run.padded(max(way.padding_samples, context), command, angle, scored)


def _command_unit(trial: Trial) -> str:
    """Unit of the device's command, in a swapped trial as well."""
    return trial.units.angle if trial.inverted else trial.units.command
