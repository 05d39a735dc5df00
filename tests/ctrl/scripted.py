"""A controller of whose device a test says what it wants."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from hystmpc.core.structs import constants, struct
from hystmpc.ctrl.command import Command, CommandLimits
from hystmpc.ctrl.estimation.observer import Observer
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.mpc_settings import PredictiveSettings
from hystmpc.ctrl.problem import problem_of
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec


class Scripted:
    """What is known of the device in the next step, written into the memory; an observer without filters leaves it.

    Attributes:
        disturbance, sigma: of the output, and the standard deviation of what noise does to it in a hold [deg].
        forecast_error: relative error of the forecasts.
    """

    def __init__(self) -> None:
        self.disturbance = self.sigma = self.forecast_error = 0.0

    def written(self, state: GuardedState) -> GuardedState:
        """A state with these numbers."""
        after = replace(state, memory=state.memory.copy())
        after.known.disturbance, after.known.variance = self.disturbance, self.sigma**2
        after.known.forecast_error = self.forecast_error
        return after


class Controller:
    """A controller without a learned part whose every step begins with what the script says."""

    def __init__(self, controller: GuardedController, script: Scripted) -> None:
        self._controller, self._script = controller, script

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def step(self, state: GuardedState, y: float, reference: Vec) -> tuple[Command, GuardedState]:
        return self._controller.step(self._script.written(state), y, reference)


def scripted(
    settings: PredictiveSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> tuple[Any, Scripted]:
    """A controller around an observer that takes every measurement and learns nothing from it, and its script."""
    settings, script = settings.model_copy(update={"adaptation": None}), Scripted()
    kind = constants()["HYSTMPC_CONTINUOUS"]
    sensing = struct("hystmpc_sensing", sensor=kind, forgets=1.0, rest_tolerance=30.0, outlier=math.inf)
    observer = Observer(sensing, predictor)
    problem: Any = problem_of(settings, predictor, inverse, limits, observer=observer)
    return Controller(GuardedController(problem, limits, observer, predictor.initial), script), script
