"""Device of the blind check: a core, withheld effects around it, and a sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..devices.cores import (
    PARTS,
    RATE_HZ,
    CapstanCore,
    Core,
    DahlCore,
    JointsCore,
    MuscleCore,
    RodCore,
    Scene,
    fine_times,
)
from .generators import Site, Withheld

PAUSE_S = 4.0
DEVICES: tuple[type[Core], ...] = (CapstanCore, DahlCore, RodCore, MuscleCore, JointsCore)
"""None of them is made of play operators."""


def lasts_s(samples: int) -> float:
    """Time from the start of a trial to that of the next [s]."""
    return samples / RATE_HZ + PAUSE_S


@dataclass(frozen=True)
class BlindDevice:
    """Simulated device from command [mm or bar] to measured angle [deg].

        x = drive effects(u),  theta = tip effects(core(x, friction effects(x))),  y = sensor effects(theta + noise)

    on a grid of 2 ms; the command goes in straight lines from sample to sample.

    Attributes:
        noise_deg: standard deviation of the white noise [deg].
        resolution_deg: step of the sensor [deg].
    """

    core: Core
    noise_deg: float
    resolution_deg: float
    seed: int
    effects: tuple[Withheld, ...] = ()

    def with_effects(self, effects: Sequence[Withheld]) -> BlindDevice:
        """Same device with other effects."""
        return replace(self, effects=tuple(effects))

    def true_angles(self, commands: Sequence[Vec]) -> list[Vec]:
        """Angles (T,) of every trial [deg], effects of the sensor included, its common noise left out."""
        return [self._angle(u, scene) for u, scene in zip(commands, self._scenes(commands), strict=True)]

    def record(self, commands: Sequence[Vec], first_trial: int = 0, clock_s: float = 0.0) -> list[Trial]:
        """Record the logs of these commands in sequence.

        Args:
            commands: (T,) each [mm or bar], at `RATE_HZ`.
            first_trial: number of trials that were recorded before.
            clock_s: time that has gone by since the first of them began.
        """
        trials = []
        for u, scene in zip(commands, self._scenes(commands, first_trial, clock_s), strict=True):
            noise = self.noise_deg * scene.random("noise").standard_normal(u.size)
            measured = self._angle(u, scene, noise)
            angle = np.round(measured / self.resolution_deg) * self.resolution_deg
            t, source = np.round(np.arange(u.size) / RATE_HZ, 6), f"trial_{scene.trial + 1:02d}.csv"
            trials.append(Trial(t, u, angle, units=Units(command=self.core.UNIT), source=source))
        return trials

    def _scenes(self, commands: Sequence[Vec], first_trial: int = 0, clock_s: float = 0.0) -> list[Scene]:
        clock, scenes = clock_s, []
        rest, full = self.core.run(np.array([0.0, 0.0]), np.ones(2))[0], self._full_bend()
        for k, u in enumerate(commands):
            scenes.append(Scene(self.seed, first_trial + k, clock, self.core.travel, rest, full - rest))
            clock += lasts_s(u.size)
        return scenes

    def _full_bend(self) -> float:
        return float(self.core.run(np.linspace(0, self.core.travel, 500), np.ones(500))[-1])

    def _angle(self, u: Vec, scene: Scene, noise: Vec | None = None) -> Vec:
        t = fine_times(u.size)
        x = np.interp(t, np.arange(u.size) / RATE_HZ, u)
        x = self._through("drive", x, scene)
        scale = np.ones(x.size)
        for effect in self._at("friction"):
            scale = scale * effect.generator.apply(x, scene, effect.size, effect.shape)
        fine = self._through("tip", self.core.run(x, scale), scene)
        sampled = fine[::PARTS] if noise is None else fine[::PARTS] + noise
        return self._through("sensor", sampled, scene)

    def _at(self, site: Site) -> list[Withheld]:
        return [effect for effect in self.effects if effect.generator.site == site]

    def _through(self, site: Site, signal: Vec, scene: Scene) -> Vec:
        for effect in self._at(site):
            signal = effect.generator.apply(signal, scene, effect.size, effect.shape)
        return signal


def core_of(numbers: Mapping[str, Any]) -> Core:
    """Build the core of these parameters; see `Core.numbers`.

    Raises:
        ConfigError: on an unknown kind of device.
    """
    kinds = {kind.__name__: kind for kind in DEVICES}
    own = dict(numbers)
    name = str(own.pop("core", ""))
    if name not in kinds:
        raise ConfigError(f"no device core {name!r}, {did_you_mean(name, kinds)}")
    return kinds[name](**own)
