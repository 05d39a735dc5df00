"""Interface of simulated plants: what closed loops, sweeps, tunings and environments ask of any of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.measurement import Sensor
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .cascade import OperatorCascade


@dataclass(frozen=True)
class Sensing:
    """The angle sensor.

    Attributes:
        noise_deg: standard deviation of white noise [deg].
        quantisation_deg: step of the angle, 0 for none [deg].
        sensors: of the library, after both.
    """

    noise_deg: float = 0.0
    quantisation_deg: float = 0.0
    sensors: Sequence[Sensor] = ()


class ComputedPlant(ABC):
    """A `ctrl.loop.Plant` that is computed; its state is hidden, as that of hardware is.

    A reset always finds the same device: rest, random numbers and noise begin anew. A subclass says where the rest is
    and what a sample does; its state is replaced from sample to sample and never altered, so that copies may share it.

    Args:
        dt_s: sample time [s].
        command_unit: mm or bar.
        seed: of noise and of what is random in the device; equal seeds give the same run after every reset.

    Raises:
        ConfigError: if the sample time is not positive.
    """

    command_limits: Range
    """What the device may be sent; the commands of a study may be narrower."""
    _state: Any

    def __init__(self, dt_s: float, rest_command: float, command_unit: str, sensing: Sensing, seed: int) -> None:
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number")
        self._dt, self._seed, self._sensing = dt_s, seed, sensing
        self.rest_command, self.command_unit = rest_command, command_unit
        self._sensors = OperatorCascade(sensing.sensors, 1.0)  # sensors have no time in them
        self._restart()

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._dt

    @property
    def seed(self) -> int:
        """Of everything random in it."""
        return self._seed

    @property
    def sensing(self) -> Sensing:
        """Its angle sensor."""
        return self._sensing

    @property
    def true_angle(self) -> float:
        """Tip angle without noise and quantisation [deg]: what metrics are made of, and no controller sees."""
        return self._angle

    def reset(self) -> float:
        """Bring the device to rest at its command of rest and return the measured tip angle [deg]."""
        self._restart()
        return self._measured()

    def apply(self, u: float) -> float:
        """Apply command `u` for one sample and return the tip angle measured at its end [deg]."""
        self._angle, self._state = self._advanced(self._state, u, self._random)
        return self._measured()

    def reseeded(self, seed: int) -> Self:
        """The same device with another realisation of everything random."""
        other = copy(self)
        other._seed = seed
        other.reset()
        return other

    def copied(self) -> Self:
        """A plant that goes on from where this one is, with the same noise to come; neither touches the other."""
        other = copy(self)
        other._random = deepcopy(self._random)
        return other

    def stop(self) -> None:  # noqa: B027  # hardware has something to do here
        """Nothing to do: a computed device is safe as it stands."""

    @abstractmethod
    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        """True angle [deg] and state before a run."""

    @abstractmethod
    def _advanced(self, state: Any, u: float, random: np.random.Generator) -> tuple[float, Any]:
        """True angle [deg] and state after command `u` for one sample."""

    def _restart(self) -> None:
        self._random = np.random.default_rng(self._seed)
        self._angle, self._state = self._at_rest(self._random)
        self._shown = sensors_at_rest(self._sensing.sensors, self._angle, self._seed)

    def _measured(self) -> float:
        angle = self._angle + self._sensing.noise_deg * float(self._random.standard_normal())
        if self._sensing.quantisation_deg:
            angle = round(angle / self._sensing.quantisation_deg) * self._sensing.quantisation_deg
        shown, self._shown = self._sensors.run(self._shown, np.array([angle]))
        return float(shown[0])


def sensors_at_rest(sensors: Sequence[Sensor], angle: float, seed: int) -> Vec:
    """State (S,) of sensors in series at a true angle [deg]; `seed` is mixed into the seed of every sensor."""
    states = [
        np.asarray(sensor.reseeded(_mixed(sensor.seed, seed, k)).at_rest(angle, angle, sensor.values)).ravel()
        for k, sensor in enumerate(sensors)
    ]
    return np.concatenate([np.empty(0), *states])


def _mixed(own: int, seed: int, k: int) -> int:
    """A seed for sensor number `k`; the generator mixes neighbouring seeds itself."""
    return (own + 1_000_003 * (seed + 7919 * k)) % 2**63
