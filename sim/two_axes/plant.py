"""Simulated device of two axes: a model of two axes with changes, its commands' drives and its sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.dynamics import stored
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import Simulator
from hystmpc.models.two_axes.model import AXES, TwoAxisModel
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.types import Vec

from ..plants.computed import OperatorCascade, RepeatablePlant
from ..plants.simulated import Effects, conditioned, fresh, plant_simulator
from .config import AxisChangesSettings, TwoAxisPlantSettings


@dataclass(frozen=True, eq=False)
class _PlantState:
    drives: tuple[Vec, ...]  # of every command
    axes: tuple[Vec, Vec]
    shared: Vec


@final
class TwoAxisPlant(RepeatablePlant):
    """Plant of a model of two axes, see `TwoAxisModel`; commands (n,) in, angles (2,) [deg] out.

    Lag and delay act on every command, changes on the simulators of the axes, noise and resolution on the angles.
    Before every run each axis does its initialisation flexure, alone, and rests at the rest of the commands.

    Args:
        model: of the device, at its sample time.
        settings: changes of the device; its `simulator` is not opened.
        seed: of the sensor noise; equal seeds give equal noise after every reset.

    Raises:
        ConfigError: if a mismatch names an unknown parameter, or an effect is a sensor.
        ModelError: if a mismatch takes a parameter out of its bounds.
    """

    def __init__(self, model: TwoAxisModel, settings: TwoAxisPlantSettings, seed: int = 0) -> None:
        self.dt, self.seed, self.rest_command = model.dt_s, seed, np.array(model.rest_commands)
        self.command_unit, self._settings = model.axes[0].command_unit, settings
        travel = model.travels(self.rest_command)
        ends = [Range(lower=low, upper=high) for low, high, _ in model.travel_limits()]
        axes = [
            replace(_changed(axis, changes, self.dt, name), rest_command=float(travel[i]))
            for i, (axis, changes, name) in enumerate(zip(model.axes, (settings.x, settings.y), "xy", strict=True))
        ]
        self._model = replace(model, axes=(axes[0], axes[1]))
        self._axes = [CompiledPredictor.of_simulator(axis) for axis in axes]
        rests = [(fresh if settings.virgin else conditioned)(axis, end) for axis, end in zip(axes, ends, strict=True)]
        actuator = Effects(lag_s=settings.lag_s, delay_s=settings.delay_s).actuator
        self._drive = OperatorCascade(stored(actuator, self.dt), self.dt)
        self._rest_deg = np.array([angle for angle, _ in rests])
        shared = model.cross_friction
        self._rest = _PlantState(
            tuple(self._drive.at_rest(float(u)) for u in self.rest_command),
            (rests[0][1], rests[1][1]),
            np.empty(0) if shared is None else shared.at_rest(travel, self.dt),
        )
        self.reset()

    @property
    def true_angle(self) -> Vec:
        """Angles (2,) [deg] without noise and quantisation, for metrics; hidden from controllers."""
        return self._angles

    def reset(self) -> Vec:
        """Bring the device to rest at its rest commands, and return the measured angles (2,) [deg]."""
        self._random, self._state = np.random.default_rng(self.seed), self._rest
        self._angles = self._model.turn @ self._rest_deg
        return self._measured()

    def apply(self, u: Vec) -> Vec:
        """Apply commands (n,) for one sample and return the angles measured at its end (2,) [deg]."""
        state = self._state
        driven = [
            self._drive.run(one, np.array([x])) for one, x in zip(state.drives, np.asarray(u).tolist(), strict=True)
        ]
        w = self._model.travels(np.array([float(sent[0]) for sent, _ in driven]))
        first, second = (
            axis.advance(x, float(w[i])) for i, (axis, x) in enumerate(zip(self._axes, state.axes, strict=True))
        )
        friction, shared, c = self._model.cross_friction, state.shared, np.zeros(AXES)
        if friction is not None:
            moved, shared = friction.advance(shared, w[None], self.dt)
            c = moved[0]
        self._angles = self._model.turn @ (np.array([first[0], second[0]]) + c)
        self._state = _PlantState(tuple(after for _, after in driven), (first[1], second[1]), shared)
        return self._measured()

    def stop(self) -> None:
        """Do nothing: a computed device is always safe."""

    def _measured(self) -> Vec:
        angles = self._angles + self._settings.noise_deg * self._random.standard_normal(AXES)
        step = self._settings.quantisation_deg
        return np.asarray(np.round(angles / step) * step if step else angles)


def _changed(axis: Simulator, changes: AxisChangesSettings, dt_s: float, name: str) -> Simulator:
    """Simulator of one axis with its changes."""
    try:
        effects = Effects(**changes.model_dump())
        if effects.sensors:
            raise ConfigError("effects: got a sensor, expected an effect of the device; see noise and quantisation")
        return plant_simulator(axis, effects, dt_s)
    except (ConfigError, ModelError) as error:
        raise type(error)(f"plant.{name}: {error}") from None
