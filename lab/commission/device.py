"""Drawn devices as the study needs them: prepared by flexures, changed by wear, and behind a bench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.commissioning.config import CommissionSettings
from hystmpc.ctrl.command import Command
from hystmpc.ctrl.frames import ImagingSettings
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.loop import Plant
from hystmpc.models.contract.metadata import Range
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import PlantFactory
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.trials.types import Vec

from ..blind.cores import CapstanCore, RodCore
from ..blind.muscle import MuscleCore
from ..identify.device import DrawnDevice, DrawnPlant

_SLOW_S, _QUICK_S, _TOP_S, _REST_S = 4.0, 1.2, 0.3, 0.5  # of a stroke of either flexure, at its top, and behind it
_BESIDE = 0.3  # of the reachable angles: how much more than them the sensor shows at either end
_SENSOR_DEG_S = 5000.0  # an air muscle jumps by 25 deg in a sample of 25 Hz
_SLACK = 0.8  # of the travel: a slack tendon moves nothing before
_RAMP = 0.3  # share of the greatest rate at which the bench moves by itself


@final
class PreparedPlant(ComputedPlant):
    """A drawn device that rests behind two flexures, a slow and a quick one, as after the preparation of a bench.

    Attributes:
        commands, angles_deg: what was sent, and the angle measured when it was (T,).
    """

    def __init__(self, plant: DrawnPlant, seed: int) -> None:
        self._plant, device = plant, plant.device
        self.command_limits = Range(lower=device.limits.lower, upper=device.limits.upper)
        asked = np.concatenate([_flexure(device, _SLOW_S), _flexure(device, _QUICK_S)])
        self.commands = device.limits.clip_plans(asked, plant.rest_command, plant.dt)
        own = plant.reseeded(seed)
        angle, angles = own.reset(), []
        for u in self.commands.tolist():
            angles.append(angle)
            angle = own.apply(u)
        self.angles_deg: Vec = np.array(angles)
        self._prepared = own.true_angle, own._state
        super().__init__(plant.dt, plant.rest_command, plant.command_unit, Sensing(device.noise_deg), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        del random
        return self._prepared

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        return self._plant._advanced(state, u, random)


def _flexure(device: DrawnDevice, stroke_s: float) -> Vec:
    """Commands up over the whole travel and back, with a rest at the top and at the end."""
    up = np.linspace(0.0, device.limits.upper, round(stroke_s * device.rate_hz) + 1)[1:]
    top = np.full(round(_TOP_S * device.rate_hz), device.limits.upper)
    rest = np.zeros(round(_REST_S * device.rate_hz))
    return np.concatenate([up, top, up[-2::-1], [0.0], rest])


@final
class TakenUp:
    """A controller that takes up the preparation of a `PreparedPlant` when it starts, as `hystmpc run` does.

    Args:
        sensor: an imaging system that has seen the preparation in frames; the angle in every sample where left out.
    """

    def __init__(
        self, controller: GuardedController[Any], plant: PreparedPlant, sensor: ImagingSettings | None = None
    ) -> None:
        self._controller, self._plant, self._angles = controller, plant, plant.angles_deg
        if sensor is not None:
            every = max(round(1.0 / (sensor.rate_hz * plant.dt)), 1)
            noise = np.random.default_rng(plant.seed).standard_normal(self._angles.size)
            seen = np.arange(self._angles.size) % every == 0
            self._angles = np.where(seen, self._angles + sensor.noise_deg * noise, np.nan)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._controller.dt

    @property
    def horizon(self) -> int:
        """Reference samples that a step looks at."""
        return self._controller.horizon

    def init(self, y: float, u: float) -> GuardedState[Any]:
        """State behind the preparation."""
        del y, u
        return self._controller.replay(self._plant.commands, self._angles)

    def step(self, state: GuardedState[Any], y: float, reference: Vec) -> tuple[Command, GuardedState[Any]]:
        """One sample."""
        return self._controller.step(state, y, reference)

    def measure(self, state: GuardedState[Any], y: float, age: float) -> GuardedState[Any]:
        """The state with a late measurement."""
        return self._controller.measure(state, y, age)


def worn(device: DrawnDevice, friction: float, stiffness: float) -> DrawnDevice:
    """The device with other friction and stiffness, as factors; a stiffer one moves less for the same command.

    The friction of a muscle is divided by its factor: with more of it the angle would rise as the pressure falls.
    """
    core = device.core
    changes: dict[str, Any]
    if isinstance(core, MuscleCore):
        changes = {"friction": core.friction / friction, "greatest_deg": core.greatest_deg / stiffness}
    else:
        own: tuple[str, ...] = ("wrap",) if isinstance(core, CapstanCore) else ("friction",)
        own += ("drag_n",) if isinstance(core, RodCore) else ()
        changes = {name: getattr(core, name) * friction for name in own} | {"gain": core.gain / stiffness}
    return replace(device, core=replace(core, **changes))


def bench_settings(plant: DrawnPlant, commission: Mapping[str, Any], folder: Path) -> CommissionSettings:
    """The bench of a drawn device and the block `commission`: what a user would write into the file."""
    device, limits = plant.device, plant.device.limits
    low, high = plant.reachable_deg
    beside = _BESIDE * (high - low)
    ramps = {
        "velocity_per_s": _RAMP * limits.rate,
        "acceleration_per_s2": 5 * limits.rate,
        "jerk_per_s3": 50 * limits.rate,
    }
    return CommissionSettings.parse(
        {
            "name": device.key,
            "rate_hz": device.rate_hz,
            "command_unit": device.unit,
            "limits": {"lower": limits.lower, "upper": limits.upper, "rate_per_s": limits.rate},
            "ramps": ramps,
            "safe_command": limits.lower,
            "sensor": {
                "lower_deg": min(low, plant.true_angle) - beside,
                "upper_deg": high + beside,
                "rate_limit_deg_s": _SENSOR_DEG_S,
            },
            "plausibility": {"travel": _SLACK * limits.upper},
            "transport": {"kind": "simulated", "plant": {"device": device.key}, "seed": device.seed % 1000},
            "prepare": [{"step": "flexure", "lower": limits.lower, "upper": limits.upper}],
            "latch_file": str(folder / "latch.json"),
            "commission": {**commission, "seed": device.seed % 1000},
        },
        device.key,
    )


def drawn_plants(device: DrawnDevice) -> PlantFactory:
    """Makes the device behind its bench; the seed of the transport is that of the noise."""

    def made(settings: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        del dt_s
        plant = DrawnPlant(device, settings.seed)
        return plant, plant.rest_command

    return made
