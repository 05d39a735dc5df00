"""Controllers that have watched the device's initialisation flexure before the first sample."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, final

import numpy as np

from hystmpc.ctrl.command import Command
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.protocols import Controller
from hystmpc.models.lstm.initial import initialisation_flexure
from hystmpc.sim.computed_plant import ComputedPlant
from hystmpc.trials.types import Vec

State = GuardedState[Any]


def watched_flexure(plant: ComputedPlant, seed: int) -> tuple[Vec, Vec]:
    """Commands sent and angles measured when each was sent, over one initialisation flexure and its rest.

    The device is flexed from the rest that `reset` leaves, and comes back to it: what was before is wiped out.

    Args:
        plant: the device; it is left as it is.
        seed: of the sensor noise, which must not be that of the run.
    """
    device = plant.reseeded(seed)
    commands = initialisation_flexure(device.command_limits, device.dt, warmup_samples=1)
    angles = [device.reset()]
    angles += [device.apply(float(u)) for u in commands]
    return commands, np.array(angles[:-1])


@final
class RehearsedController(Controller[State]):
    """A controller that starts from a recording instead of a single measurement.

    Args:
        controller: what decides.
        commands, angles: see `GuardedController.replay`.
    """

    def __init__(self, controller: GuardedController[Any], commands: Vec, angles: Vec) -> None:
        self._controller, self._commands, self._angles = controller, commands, angles

    @property
    def dt(self) -> float:
        return self._controller.dt

    @property
    def horizon(self) -> int:
        return self._controller.horizon

    def init(self, y: float, u: float) -> State:
        del u  # the recording ends with it
        return replace(self._controller.replay(self._commands, self._angles), due=y)

    def step(self, state: State, y: float, reference: Vec) -> tuple[Command, State]:
        return self._controller.step(state, y, reference)
