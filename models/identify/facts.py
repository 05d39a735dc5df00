"""What a model file says about the trials that its model was identified on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hystmpc.trials.trial import Trial

from ..contract.metadata import InitialRule, ModelMetadata
from ..model import Array
from .simulator import DeviceLimits
from .trial_set import angle_range, check_trial_set, command_range, fastest_command, fingerprint

Fact = str | float | int | bool


def facts_of(
    kind: str,
    trials: Sequence[Trial],
    limits: DeviceLimits,
    rules: tuple[InitialRule, InitialRule],
    warmup_samples: int,
    training: Mapping[str, Fact],
) -> ModelMetadata:
    """Metadata of a model identified on `trials`: ranges, fingerprint and names of the logs are theirs.

    Args:
        kind: name of the kind.
        trials: all that it was given.
        limits: what the device may be sent; what the trials show where left out.
        rules: `initial` and `conditioned`.
        warmup_samples: see `ModelMetadata`.
        training: further facts.

    Raises:
        FitError: on unusable trials.
        ModelError: if they are beyond what a model file may say.
    """
    dt, trained = check_trial_set(trials), command_range(trials)
    return ModelMetadata.of(
        kind=kind,
        dt_s=dt,
        command_unit=trials[0].units.command,
        angle_unit=trials[0].units.angle,
        command_limits=limits.command or trained,
        command_rate=limits.rate_per_s or fastest_command(trials),
        trained_command=trained,
        trained_angle=angle_range(trials),
        trained_rate=fastest_command(trials),
        initial=rules[0],
        conditioned=rules[1],
        warmup_samples=warmup_samples,
        training_data_hash=fingerprint(trials),
        training={**training, "logs": ", ".join(Path(trial.source).name for trial in trials)},
    )


def fixed_rule(state: Array) -> InitialRule:
    """A start (S,) that does not depend on the measured angle."""
    return InitialRule(offset=tuple(state.tolist()), slope=(0.0,) * state.size)
