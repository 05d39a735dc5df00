"""A backlash fitted to the free run of a model, in its place where an inverse is needed."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.trial import Trial, Units

from ..chain import Chain
from ..evaluate import free_run
from ..identify.chain_kinds import backlash_starts
from ..identify.least_squares import OperatorFitSettings, fit_chain
from ..model import LoadedModel
from ..motions import probe_commands
from ..simulator import Simulator, simulator_for


def surrogate_backlash(model: LoadedModel) -> Simulator:
    """Simulator whose backlash follows the model's free run over a decaying sinusoid of its trained range.

    The motion is `probe_commands`; its first flexure does not count.

    Raises:
        FitError: if the model's angle does not rise with the command.
    """
    facts = model.metadata
    commands = probe_commands(facts)
    theta = free_run(model, commands, 0.5 * (facts.trained_angle.lower + facts.trained_angle.upper))
    t = np.arange(commands.size, dtype=np.float64) * facts.dt_s
    trial = Trial(
        t,
        commands,
        theta,
        units=Units(facts.command_unit, facts.angle_unit, inverse=False),
        source="the model's own free run",
    )
    fit = fit_chain(backlash_starts([trial]), [trial], OperatorFitSettings(skip_first_flexure=True))
    method = f"backlash fitted to the free run of a model of kind {facts.kind}"
    return simulator_for(Chain(fit.chain.core), facts, method)
