"""Session of scans: commands to device and models, and the recorded scans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.types import Vec

from .geometry import NotNegative, Positive

# Command (N,) [bar] at the session's rate to true and sensed angles (N,) [deg]; starts at rest at command 0.
Device = Callable[[Vec], tuple[Vec, Vec]]
# Command (N,) [bar] to the model's angles (N,) [deg], over the whole session.
Estimator = Callable[[Vec], Vec]
_INTEGER = 1e-9


@dataclass(frozen=True, eq=False)
class Scan:
    """Angles of one scan, sample by sample.

    Attributes:
        rotation_deg: of the cap [deg].
        true_deg: angles of the tip, along which distances are measured (T,) [deg].
        sensed_deg: angles by the sensor, of which the ground truth is made (T,) [deg].
        estimates_deg: angles by each model, (T,) each [deg].

    Raises:
        ConfigError: if the scan is empty or an angle of device or sensor is not finite, or lengths differ.
        ModelError: if that holds for a model's angles.
    """

    rotation_deg: float
    true_deg: Vec
    sensed_deg: Vec
    estimates_deg: Mapping[str, Vec]

    def __post_init__(self) -> None:
        if self.true_deg.ndim != 1 or self.true_deg.size == 0:
            raise ConfigError(f"{self.where}: got true angles of shape {self.true_deg.shape}, expected (T,) with T > 0")
        if problem := self._problem(self.true_deg):
            raise ConfigError(f"{self.where}: true angles: {problem}")
        if problem := self._problem(self.sensed_deg):
            raise ConfigError(f"{self.where}: sensed angles: {problem}")
        for name, angles in self.estimates_deg.items():
            if problem := self._problem(angles):
                raise ModelError(f"{self.where}: model {name!r}: {problem}")

    @property
    def where(self) -> str:
        """Name of the scan in messages."""
        return f"scan at {self.rotation_deg:g} deg"

    def _problem(self, angles: Vec) -> str:
        """Reason to reject an array of angles; empty where it is fine."""
        if angles.shape != self.true_deg.shape:
            return f"got shape {angles.shape}, expected {self.true_deg.shape}"
        bad = ~np.isfinite(angles)
        return f"got {angles[bad][0]} at sample {int(np.argmax(bad))}, expected finite angles" if np.any(bad) else ""


class Protocol(Settings):
    """Protocol of 18 scans of one period each: p(t) = P/2 (sin(2 pi f t - pi/2) + 1), with 15 deg of rotation between.

    Source: S1 section III-B; [I] inferred or ours, not printed.

    Attributes:
        peak_bar: P, the highest pressure of a period; S1's A is read as the peak value [I] [bar].
        frequency_hz: f [Hz].
        scans: number of rotations; 18 of 15 deg make S1's 270 deg.
        step_deg: rotation between two scans; the first is at 0 [deg].
        rest_s: at pressure 0 while the cap turns [I] [s].
        lead_in_periods: run before the first scan, so that it has the same history as the others [I].
        rate_hz: of device and models; 250 is that of S1's laser [Hz].
        oct_rate_hz: of the distances, which are kept; must divide the rate [I] [Hz].
    """

    peak_bar: Positive = 2.95
    frequency_hz: Positive = 0.1
    scans: Annotated[int, Field(ge=1)] = 18
    step_deg: Positive = 15.0
    rest_s: NotNegative = 1.0
    lead_in_periods: Annotated[int, Field(ge=0)] = 1
    rate_hz: Positive = 250.0
    oct_rate_hz: Positive = 25.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        stride = self.rate_hz / self.oct_rate_hz
        if stride < 1 - _INTEGER or abs(stride - round(stride)) > _INTEGER * stride:
            raise ValueError(f"protocol: OCT rate {self.oct_rate_hz:g} Hz does not divide the rate {self.rate_hz:g} Hz")
        if self.rate_hz < 4 * self.frequency_hz:
            raise ValueError(f"protocol: got rate {self.rate_hz:g} Hz, expected at least 4 samples a period")
        return self


@dataclass(frozen=True, eq=False)
class Session:
    """Commands of all scans in sequence.

    Attributes:
        dt_s: sample time [s].
        command: pressures (N,) [bar].
        samples: for each scan the indices at which a distance is measured.
        rotations_deg: of the cap, for each scan [deg].
    """

    dt_s: float
    command: Vec
    samples: tuple[NDArray[np.intp], ...]
    rotations_deg: tuple[float, ...]


def session(protocol: Protocol) -> Session:
    """Build the session of a protocol: lead-in, then period and rest for every scan."""
    period = round(protocol.rate_hz / protocol.frequency_hz)
    phase = 2 * np.pi * np.arange(period) / period
    stroke = protocol.peak_bar / 2 * (np.sin(phase - np.pi / 2) + 1)
    rest = np.zeros(round(protocol.rest_s * protocol.rate_hz))
    lead_in = np.concatenate([np.tile(stroke, protocol.lead_in_periods), rest])
    command = np.concatenate([lead_in, np.tile(np.concatenate([stroke, rest]), protocol.scans)])
    stride = round(protocol.rate_hz / protocol.oct_rate_hz)
    starts = lead_in.size + np.arange(protocol.scans) * (period + rest.size)
    return Session(
        dt_s=1.0 / protocol.rate_hz,
        command=command,
        samples=tuple(np.arange(start, start + period, stride) for start in starts),
        rotations_deg=tuple(k * protocol.step_deg for k in range(protocol.scans)),
    )


def record_scans(protocol: Protocol, device: Device, models: Mapping[str, Estimator]) -> tuple[Scan, ...]:
    """Run device and models once over the whole session and cut the scans out.

    Raises:
        ConfigError: if the device's answer has another length than the command, or is not finite.
        ModelError: if that holds for a model's.
    """
    plan = session(protocol)
    shape = plan.command.shape
    true, sensed = (np.asarray(angles, float) for angles in device(plan.command.copy()))
    for what, angles in (("true", true), ("sensed", sensed)):
        if angles.shape != shape:
            raise ConfigError(f"device: got {what} angles of shape {angles.shape}, expected {shape} as the command")
    estimates = {}
    for name, model in models.items():
        estimates[name] = np.asarray(model(plan.command.copy()), float)
        if estimates[name].shape != shape:
            raise ModelError(
                f"model {name!r}: got angles of shape {estimates[name].shape}, expected {shape} as the command"
            )
    return tuple(
        Scan(rotation, true[at], sensed[at], {name: angles[at] for name, angles in estimates.items()})
        for rotation, at in zip(plan.rotations_deg, plan.samples, strict=True)
    )
