"""A simulated device behind the interface that the closed loop talks to."""

from __future__ import annotations

from copy import copy
from typing import final

import numpy as np

from hystmpc.trajectories.excitation import s2_initialisation
from hystmpc.trials.errors import ConfigError

from .device import Device
from .sensors import quantised


@final
class DevicePlant:
    """A `ctrl.protocols.Plant` of a `Device`; its state is hidden, as that of hardware is.

    Before every run the device does its initialisation flexure (one period of 0.1 Hz over all of its commands) and
    rests for 5 s at the lowest one.

    Args:
        device: what is controlled.
        dt_s: sample time [s].
        noise_deg: standard deviation of the angle's white noise [deg].
        quantisation_deg: step of the angle, 0 for none [deg].
        seed: of noise and friction; equal seeds give the same run after every reset.

    Raises:
        ConfigError: if the sample time is not positive, or noise or step is negative.
    """

    def __init__(
        self, device: Device, dt_s: float = 0.04, noise_deg: float = 0.05, quantisation_deg: float = 0.0, seed: int = 0
    ) -> None:
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number")
        if not min(noise_deg, quantisation_deg) >= 0:
            raise ConfigError(f"plant: got noise {noise_deg}, step {quantisation_deg} deg, expected numbers >= 0")
        self._device, self._dt, self._seed = device, dt_s, seed
        self._noise, self._step = noise_deg, quantisation_deg
        self.rest_command = device.commands[0]
        self.reset()

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._dt

    @property
    def true_angle(self) -> float:
        """Tip angle without noise and quantisation [deg]: what metrics are made of, and no controller sees."""
        return self._angle

    def reset(self) -> float:
        """Flex the device, bring it to rest at its lowest command and return the measured tip angle [deg]."""
        self._random = np.random.default_rng(self._seed)
        flexure = s2_initialisation()
        wave = flexure(np.arange(0.0, flexure.duration_s, self._dt))
        lower, upper = self._device.commands
        commands = np.concatenate([lower + (upper - lower) * wave / wave.max(), np.full(round(5.0 / self._dt), lower)])
        done = self._device.advance(self._device.virgin(), commands, self._dt, self._random)
        self._angle, self._state = float(done.angle[-1]), done.state
        return self._measured()

    def apply(self, u: float) -> float:
        """Apply command `u` for one sample and return the tip angle measured at its end [deg]."""
        done = self._device.advance(self._state, np.array([u]), self._dt, self._random)
        self._angle, self._state = float(done.angle[0]), done.state
        return self._measured()

    def reseeded(self, seed: int) -> DevicePlant:
        """The same device with another realisation of its noise and friction."""
        other = copy(self)
        other._seed = seed
        other.reset()
        return other

    def stop(self) -> None:
        """Nothing to do: a computed device is safe as it stands."""

    def _measured(self) -> float:
        noisy = np.array([self._angle + self._noise * self._random.standard_normal()])
        return float(quantised(noisy, self._step)[0])
