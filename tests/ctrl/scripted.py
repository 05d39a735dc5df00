"""A controller without a sensor, of whose device a test says what is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hystmpc.core.structs import constants, struct
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.estimation.observer import Observer
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.mpc_settings import PredictiveSettings
from hystmpc.ctrl.problem import problem_of
from hystmpc.models.model import Inverse, Predictor


class Scripted:
    """What is known of the device: without a sensor the observer leaves it as it is.

    Attributes:
        disturbance, sigma: of the output, and the standard deviation of what noise does to it in a hold [deg].
        forecast_error: relative error of the forecasts.
    """

    def __init__(self, predictor: Predictor) -> None:
        self.disturbance = self.sigma = self.forecast_error = 0.0
        kind = constants()["HYSTMPC_NO_SENSOR"]
        sensing = struct("hystmpc_sensing", sensor=kind, forgets=1.0, rest_tolerance=30.0)
        self.observer = Observer(sensing, predictor)

    def written(self, state: GuardedState) -> GuardedState:
        """The state of a controller that knows this."""
        after = replace(state, memory=state.memory.copy())
        known = after.known
        known.disturbance, known.variance, known.forecast_error = self.disturbance, self.sigma**2, self.forecast_error
        return after


def scripted(
    settings: PredictiveSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> tuple[GuardedController, Scripted]:
    """A controller without a learned part around such an observer."""
    settings, script = settings.model_copy(update={"adaptation": None}), Scripted(predictor)
    problem: Any = problem_of(settings, predictor, inverse, limits, observer=script.observer)
    return GuardedController(problem, limits, script.observer, predictor.initial), script
