"""A trained network with all that its model file says about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.trial import Trial

from ..contract.bundle import ExportBundle
from ..contract.metadata import InitialRule, ModelMetadata, Range
from ..identify.trial_set import DeviceLimits, angle_range, check_trial_set, command_range, fastest_command, fingerprint
from ..lstm.initial import initialisation_flexure
from ..networks.nodes import network_step_graph
from ..probe import probe_commands
from .networks import NetworkFit

if TYPE_CHECKING:
    from ..networks.reference_ import TorchStep


def network_bundle(fit: NetworkFit, trials: Sequence[Trial], limits: DeviceLimits | None = None) -> ExportBundle:
    """Graph, facts, reference and probe of a trained network, ready for `export_onnx`.

    Args:
        fit: what `fit_network` returned.
        trials: those it was given, held-out ones included; ranges and fingerprint are theirs.
        limits: what the device may be sent; what the trials show where left out.

    Raises:
        FitError: on unusable trials.
        ModelError: if they are beyond what a model file may say.
    """
    from ..networks.reference_ import TorchStep  # torch is there: the network was trained with it

    limits = limits or DeviceLimits()
    step = TorchStep(fit.net, fit.scaling)
    dt, trained, warmup = check_trial_set(trials), command_range(trials), fit.settings.warmup_samples
    rest = float(np.median([trial.angle[0] for trial in trials]))
    metadata = ModelMetadata.of(
        kind=fit.settings.kind,
        dt_s=dt,
        command_unit=trials[0].units.command,
        angle_unit=trials[0].units.angle,
        command_limits=limits.command or trained,
        command_rate=limits.rate_per_s or fastest_command(trials),
        trained_command=trained,
        trained_angle=angle_range(trials),
        trained_rate=fastest_command(trials),
        initial=step.initial_rule(),
        conditioned=_conditioned_rule(step, trained, rest, dt, warmup),
        warmup_samples=warmup,
        training_data_hash=fingerprint(trials),
        training={
            "preset": fit.settings.preset,
            "settings": fit.settings.model_dump_json(),
            "best_step": fit.best_step,
            "validation_rmse_deg": fit.validation_rmse_deg,
            "interrupted": fit.interrupted,
            "logs": ", ".join(Path(trial.source).name for trial in trials),
            "held_out": ", ".join(Path(source).name for source in fit.held_out),
        },
    )
    graph = network_step_graph(f"{fit.settings.kind}_step", fit.net.state_size, fit.scaling, fit.net.write)
    return ExportBundle(graph, metadata, step, probe_commands(metadata))


def _conditioned_rule(step: TorchStep, trained: Range, rest: float, dt_s: float, warmup: int) -> InitialRule:
    """State after the initialisation flexure, from rest at angle `rest`; what is measured starts as in a trial.

    The flexure is that of S2, see `initialisation_flexure`.
    """
    initial = step.initial_rule()
    start = initial.state(np.array([[rest]]))[0]
    _, state = step.run(start, initialisation_flexure(trained, dt_s, warmup))
    known = np.arange(step.state_size) >= step.state_size - step.measured
    offset, slope = np.where(known, initial.offset, state), np.where(known, initial.slope, 0.0)
    return InitialRule(offset=tuple(offset.tolist()), slope=tuple(slope.tolist()))
