"""A controller whose observer says what a test wants of the device."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from hystmpc.core.outside import guarded
from hystmpc.core.structs import constants, layout, struct
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.estimation.observer import Observer
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.mpc_settings import PredictiveSettings
from hystmpc.ctrl.problem import problem_of
from hystmpc.models.model import Inverse, Predictor


class Scripted:
    """An observer as the engine calls it: it advances the model, and what it says of the device is set here.

    Attributes:
        disturbance, sigma: of the output, and the standard deviation of what noise does to it in a hold [deg].
        forecast_error: relative error of the forecasts.
    """

    def __init__(self, predictor: Predictor) -> None:
        self.disturbance = self.sigma = self.forecast_error = 0.0
        self._predictor, self._states = predictor, int(predictor.part.fields["states"])
        outside = struct("hystmpc_observer_outside", correct=guarded(self._correct), advance=guarded(self._advance))
        kind = constants()["HYSTMPC_OBSERVED"]
        sensing = struct("hystmpc_sensing", sensor=kind, forgets=1.0, rest_tolerance=30.0, outside=outside)
        self.observer = Observer(sensing, predictor)

    def _correct(self, known: int, _x: int, _angles: int, y: float) -> None:
        k = layout("hystmpc_known").from_address(known)
        k.disturbance, k.sigma, k.forecast_error = self.disturbance, self.sigma, self.forecast_error
        k.measured, k.missing = y, 0

    def _advance(self, known: int, x: int, angles: int, u: float) -> None:
        state = np.ctypeslib.as_array((ctypes.c_double * self._states).from_address(x))
        angle, state[:] = self._predictor.advance(state.copy(), u)
        ctypes.c_double.from_address(angles).value = angle
        layout("hystmpc_known").from_address(known).command = u


def scripted(
    settings: PredictiveSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> tuple[GuardedController, Scripted]:
    """A controller without a learned part around such an observer."""
    settings, script = settings.model_copy(update={"adaptation": None}), Scripted(predictor)
    problem: Any = problem_of(settings, predictor, inverse, limits, observer=script.observer)
    return GuardedController(problem, limits, script.observer, predictor.initial), script
