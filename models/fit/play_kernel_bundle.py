"""An identified play-kernel model with all that its model file says about it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hystmpc.trials.trial import Trial

from ..contract.bundle import ExportBundle
from ..identify.trial_set import DeviceLimits, check_trial_set, command_range, facts_of, fixed_rule
from ..lstm.initial import initialisation_flexure
from ..model import Array
from ..play_kernel.graph import play_kernel_graph
from ..play_kernel.step import PlayKernelStep
from ..probe import probe_commands
from .play_kernel import PlayKernelFit
from .play_kernel_settings import PlayKernelSettings

_SETTLED_LAGS = 20.0  # time constants after which nothing is left of a step


def play_kernel_bundle(
    fit: PlayKernelFit, trials: Sequence[Trial], settings: PlayKernelSettings, limits: DeviceLimits
) -> ExportBundle:
    """Graph, facts, reference and probe of a play-kernel model, ready for `export_onnx`.

    A fresh device has rested at the command at which the trials begin, so that no play is in contact; a conditioned
    one has been flexed to the top of the trained commands and back. The first command is held until the lag has
    settled.

    Raises:
        FitError: on unusable trials.
    """
    weights = fit.weights
    step = PlayKernelStep(weights)
    warmup = max(1, math.ceil(_SETTLED_LAGS * fit.choice.lag_s / check_trial_set(trials)))
    fresh = np.full(weights.state_size, float(np.mean([trial.command[0] for trial in trials])))
    metadata = facts_of(
        "play_kernel",
        trials,
        limits,
        (fixed_rule(fresh), fixed_rule(_flexed(step, fresh, trials, warmup))),
        warmup,
        {
            "preset": settings.preset,
            "settings": settings.model_dump_json(),
            "lag_s": fit.choice.lag_s,
            "smoothness": fit.choice.smoothness,
            "training_rmse": fit.rmse,
            "interrupted": fit.interrupted,
        },
    )
    return ExportBundle(play_kernel_graph(weights), metadata, step, probe_commands(metadata))


def _flexed(step: PlayKernelStep, state: Array, trials: Sequence[Trial], warmup: int) -> Array:
    """State (S,) after the initialisation flexure of S2."""
    at = state[None]
    for u in initialisation_flexure(command_range(trials), check_trial_set(trials), warmup):
        _, at = step.advance(at, np.array([[u]]))
    return at[0]
