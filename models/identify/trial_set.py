"""What a set of trials says about itself: sample time, ranges, fingerprint, and whether a model can be identified."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.metadata import DeviceLimits, InitialRule, ModelMetadata, Range

LEAST_SAMPLES = 50


def fingerprint(trials: Sequence[Trial]) -> str:
    """SHA-256 over time, command and angle of all trials, in order."""
    digest = hashlib.sha256()
    for trial in trials:
        for signal in (trial.t, trial.command, trial.angle):
            digest.update(np.ascontiguousarray(signal).tobytes())
    return digest.hexdigest()


def command_range(trials: Sequence[Trial]) -> Range:
    """Least and greatest command [cmd]."""
    return Range(lower=float(min(t.command.min() for t in trials)), upper=float(max(t.command.max() for t in trials)))


def angle_range(trials: Sequence[Trial]) -> Range:
    """Least and greatest angle [deg]."""
    return Range(lower=float(min(t.angle.min() for t in trials)), upper=float(max(t.angle.max() for t in trials)))


def fastest_command(trials: Sequence[Trial]) -> float:
    """Greatest speed of the command [cmd/s]."""
    return float(max(np.max(np.abs(np.diff(t.command)) / np.diff(t.t)) for t in trials))


def check_trial_set(trials: Sequence[Trial]) -> float:
    """Return the common sample time [s].

    Raises:
        FitError: if there is no trial, one is too short, sample times or units differ, or command or angle is constant.
    """
    if not trials:
        raise FitError("got no trials, expected at least one")
    dt, units = float(f"{trials[0].dt:.10g}"), trials[0].units  # 0.04, not the difference of two time stamps
    for trial in trials:
        if len(trial) < LEAST_SAMPLES:
            raise FitError(f"{trial.source}: {len(trial)} samples, expected at least {LEAST_SAMPLES}")
        if abs(trial.dt - dt) > 1e-3 * dt:
            raise FitError(
                f"{trial.source}: sampled every {trial.dt:.6g} s, expected {dt:.6g} s as {trials[0].source}; resample"
            )
        if trial.units != units:
            raise FitError(f"{trial.source}: units {trial.units}, expected {units} as {trials[0].source}")
        for name, signal in (("command", trial.command), ("angle", trial.angle)):
            if np.ptp(signal) <= 1e-9 * max(1.0, float(np.max(np.abs(signal)))):
                raise FitError(f"{trial.source}: the {name} is constant at {signal[0]:.6g}, expected a motion")
    return dt


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


def fixed_rule(state: Vec) -> InitialRule:
    """A start (S,) that does not depend on the measured angle."""
    return InitialRule(offset=tuple(state.tolist()), slope=(0.0,) * state.size)
