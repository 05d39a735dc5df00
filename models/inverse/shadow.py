"""A backlash fitted to what a model itself predicts: the operator that stands in for it where an inverse is needed."""

from __future__ import annotations

import numpy as np
from hystmpc.trials.trial import Trial, Units

from ..chain import Chain
from ..evaluate import RunnableModel, free_run
from ..fit.operators import OperatorFitSettings, fit_chain
from ..fit.starts import backlash_starts
from ..simulator import Identification, Simulator

CYCLES, FREQUENCY_HZ = 7, 0.2


def shadow_simulator(model: RunnableModel) -> Simulator:
    """Simulator whose backlash follows the model's free run over a decaying sinusoid of its trained range.

    The sinusoid is S2 eq. (9)-(10) with its mean in the middle, at 0.2 Hz; the first flexure does not count.

    Raises:
        FitError: if the model's angle does not rise with the command.
    """
    facts = model.metadata
    low, high = facts.trained_command.lower, facts.trained_command.upper
    t = np.arange(0.0, CYCLES / FREQUENCY_HZ, facts.dt_s)
    decay = np.exp(-FREQUENCY_HZ / 6 * np.log(7) * t)
    swing = 0.5 * (high - low) * (decay * np.sin(2 * np.pi * FREQUENCY_HZ * t - np.pi / 2) + 1)
    commands = low + swing
    theta = free_run(model, commands, 0.5 * (facts.trained_angle.lower + facts.trained_angle.upper))
    trial = Trial(t, commands, theta, units=Units(facts.command_unit), source="the model's own free run")
    fit = fit_chain(backlash_starts([trial]), [trial], OperatorFitSettings(skip_first_flexure=True))
    return Simulator(
        chain=Chain(fit.chain.core),
        dt_s=facts.dt_s,
        command_unit=facts.command_unit,
        command_limits=facts.command_limits,
        command_rate_per_s=facts.command_rate,
        trained_command=facts.trained_command,
        trained_angle_deg=facts.trained_angle,
        trained_rate_per_s=facts.trained_rate,
        identification=Identification(method=f"backlash fitted to the free run of a model of kind {facts.kind}"),
    )
