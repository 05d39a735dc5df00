"""A trained LSTM with all that its model file says about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hystmpc.trials.trial import Trial

from ..contract.bundle import ExportBundle
from ..contract.metadata import ModelMetadata
from ..lstm.graph import lstm_step_graph
from ..lstm.initial import conditioned_rule, zero_state_rule
from ..lstm.reference import LstmStep
from ..probe import probe_commands
from .identify import DeviceLimits
from .lstm import LstmFit
from .trial_set import angle_range, check_trial_set, command_range, fastest_command, fingerprint


def lstm_bundle(fit: LstmFit, trials: Sequence[Trial], limits: DeviceLimits | None = None) -> ExportBundle:
    """Graph, facts, reference and probe of a trained LSTM, ready for `export_onnx`.

    Args:
        fit: what `fit_lstm` returned.
        trials: those it was given, held-out ones included; ranges and fingerprint are theirs.
        limits: what the device may be sent; what the trials show where left out.

    Raises:
        FitError: on unusable trials.
    """
    limits = limits or DeviceLimits()
    step = LstmStep(fit.weights)
    dt, trained, warmup = check_trial_set(trials), command_range(trials), fit.settings.warmup_samples
    metadata = ModelMetadata(
        kind="lstm",
        dt_s=dt,
        command_unit=trials[0].units.command,
        angle_unit=trials[0].units.angle,
        command_limits=limits.command or trained,
        command_rate=limits.rate_per_s or fastest_command(trials),
        trained_command=trained,
        trained_angle=angle_range(trials),
        trained_rate=fastest_command(trials),
        initial=zero_state_rule(step.state_size),
        conditioned=conditioned_rule(step, trained, dt, warmup),
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
    return ExportBundle(lstm_step_graph(fit.weights), metadata, step, probe_commands(metadata))
