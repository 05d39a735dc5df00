"""Controllers of the studies: one with the device itself as its model, and one that starts from a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import Command
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.loop import Controller
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from . import kernels
from .drawn import DrawnDevice, at_rest, packed
from .kernels import FINE_S

_DIFFERENCE = 2e-3  # of the travel
_BLOCKS = 12


@final
class ExactPredictor(Predictor):
    """Predictor that is the device itself, without whole samples of its delay; its state is a copy of the device's.

    Derivatives are differences over a five-hundredth of the travel. Plans of more than 12 samples move in 12 blocks, so
    that a step costs as much as 12 roll-outs at most.
    """

    def __init__(self, device: DrawnDevice) -> None:
        self.dt, self.command_range = 1 / device.rate_hz, (device.limits.lower, device.limits.upper)
        fine = round(self.dt / FINE_S)
        self.delay_samples = round(device.delay_s / FINE_S) // fine
        self.packed = packed(device, device.delay_s - self.delay_samples * self.dt)
        self._rest = at_rest(device, self.packed)[1]
        self._small = _DIFFERENCE * device.limits.upper

    def initial(self, y: float, u: float) -> Vec:
        del y, u  # where the device rests is known
        return self._rest.copy()

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        after = state.copy()
        return float(kernels.advance(self.packed, after, float(u))), after

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        theta = np.empty(plans.shape)
        kernels.rollout(self.packed, state, np.ascontiguousarray(plans, dtype=np.float64), theta)
        return theta

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, jacobian = np.empty(plan.size), np.empty((plan.size, plan.size))
        plan = np.ascontiguousarray(plan, dtype=np.float64)
        kernels.linearise(self.packed, state, plan, self._small, _BLOCKS, theta, jacobian)
        return theta, jacobian


@final
class ExactInverse(Inverse):
    """Command that brings the core to an angle through a drive without lag; the law itself looks ahead."""

    def __init__(self, predictor: ExactPredictor) -> None:
        self._predictor = predictor

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        del u_last  # within a dead band the core does not move
        p, (low, high) = self._predictor.packed, self._predictor.command_range
        crept = p.creep * float(state[p.commands + 2])
        place = kernels.place_for(p, state, float(theta), low, high * (1 + p.creep))
        return min(max(float(place) - crept, low), high)


def exact_controller(device: DrawnDevice, settings: LinearisedMpcSettings) -> GuardedController:
    """The linearised law on the device itself.

    Args:
        settings: of the law; the estimator is told the whole samples of the delay.
    """
    predictor = ExactPredictor(device)
    estimator = settings.estimator.model_copy(update={"delay_samples": predictor.delay_samples})
    settings = settings.model_copy(update={"estimator": estimator})
    return build_controller(settings, predictor, ExactInverse(predictor), device.limits)


class Rehearsed(Controller[GuardedState]):
    """Controller that starts from a recording instead of a single measurement."""

    def __init__(self, controller: GuardedController, commands: Vec, angles: Vec) -> None:
        self._controller, self._commands, self._angles = controller, commands, angles

    @property
    def dt(self) -> float:
        return self._controller.dt

    @property
    def horizon(self) -> int:
        return self._controller.horizon

    def init(self, y: float, u: float) -> GuardedState:
        del u  # the recording ends with it
        state = self._controller.replay(self._commands, self._angles)
        state = replace(state, memory=state.memory.copy())
        state.head.due = y
        return state

    def step(self, state: GuardedState, y: float, reference: Vec) -> tuple[Command, GuardedState]:
        return self._controller.step(state, y, reference)

    def measure(self, state: GuardedState, y: float, age: float) -> GuardedState:
        return self._controller.measure(state, y, age)
