"""Recording on a simulated bench: sampled commands, seeds by trial name, and the bench of S2 with its tracker."""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from hystmpc.models.maps import S2_TIP_MAP, TipMap
from hystmpc.sim.devices.device import Device, Quantities, quantity
from hystmpc.sim.devices.tendon import TendonCatheter, TendonParameters
from hystmpc.trajectories.excitation import s2_initialisation
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units, resample
from hystmpc.trials.types import Vec

_TURN_DEG = 40.0  # tip angle over which the field's distortion turns once
_ROUNDING = 1e-9  # of a sample, so that a duration of whole samples is not cut short


@dataclass(frozen=True)
class EmTracker(Quantities):
    """Electromagnetic tracker of S2 on the tip: angle, and X, Y by the quadratic map of S2.

    S2 states an accuracy of +-0.35 deg and +-1.4 mm, which is mostly distortion of the field: it depends on the pose
    and is equal in every trial. Here it is a sine of the tip angle, of half the stated size for the angle, and of 0.3
    mm for the position, whose rest would be a shift of the frame. The white noise has the size of recorded logs
    resampled to 25 Hz.
    """

    distortion_deg: float = quantity(0.175, "deg", 0.0, 10.0, "amplitude of the distortion of the angle")
    noise_deg: float = quantity(0.05, "deg", 0.0, 10.0, "standard deviation of the angle's noise")
    quantisation_deg: float = quantity(180.0 / 2**15, "deg", 0.0, 10.0, "step of the angle")
    distortion_mm: float = quantity(0.3, "mm", 0.0, 10.0, "amplitude of the distortion of X and Y")
    noise_mm: float = quantity(0.05, "mm", 0.0, 10.0, "standard deviation of the noise of X and Y")
    tip: TipMap = field(default_factory=lambda: S2_TIP_MAP)

    def __call__(self, angle_deg: Vec, random: np.random.Generator) -> tuple[Vec, Vec, Vec]:
        """Measured angle [deg], X and Y [mm] from true angles, all (T,)."""
        noise = random.standard_normal((3, angle_deg.size))
        phase = 2 * np.pi * angle_deg / _TURN_DEG
        angle = angle_deg + self.distortion_deg * np.sin(phase) + self.noise_deg * noise[0]
        x, y = self.tip(angle_deg)
        x = x + self.distortion_mm * np.sin(phase + 1.0) + self.noise_mm * noise[1]
        y = y + self.distortion_mm * np.sin(phase + 2.0) + self.noise_mm * noise[2]
        return quantised(angle, self.quantisation_deg), x, y


def quantised(values: Vec, step: float) -> Vec:
    """Values rounded to multiples of `step`; unchanged for step 0."""
    return np.round(values / step) * step if step > 0 else values


def sampled(excitation: Trajectory, rate_hz: float) -> tuple[Vec, Vec]:
    """Times [s] and commands, both (T,), on a grid that begins at 0 and ends before the duration."""
    count = max(int(np.ceil(excitation.duration_s * rate_hz - _ROUNDING)), 2)
    t = np.arange(count) / rate_hz
    return t, np.asarray(excitation(t), dtype=np.float64)


def generator(seed: int, name: str, purpose: str) -> np.random.Generator:
    """Random numbers of one trial for one purpose, independent of all other trials."""
    return np.random.default_rng([seed, zlib.crc32(f"{purpose}:{name}".encode())])


@dataclass(frozen=True, kw_only=True)
class TrackedBench(Quantities, ABC):
    """Bench of S2 with any device.

    Every trial begins with a virgin device, the initialisation flexure (0.1 Hz to the end of the travel and back) and a
    rest at 0 mm, which are discarded as S2's protocol says unless `keep_flexure`.

    Attributes:
        command_rate_hz: rate of command and log [Hz].
        rate_hz: rate of the trial, by linear interpolation [Hz].
        rest_s: rest between flexure and motion [s].
    """

    tracker: EmTracker = field(default_factory=EmTracker)
    command_rate_hz: float = quantity(100.0, "Hz", 1.0, 10_000.0, "rate of command and log (S2's code)")
    rate_hz: float = quantity(25.0, "Hz", 1.0, 10_000.0, "rate of the trial (S2)")
    rest_s: float = quantity(2.0, "s", 0.0, 1000.0, "rest between flexure and motion")
    keep_flexure: bool = False  # leave flexure and rest in the trial

    @abstractmethod
    def mounted(self, random: np.random.Generator) -> Device:
        """Device of one trial, with the variation between trials."""

    def record(self, excitation: Trajectory, seed: int, source: str) -> Trial:
        """Record one trial; equal seed and source give equal trials, others another device and noise.

        Channels: `x_mm`, `y_mm` of the tip, `displacement_mm` that the drive reached, `tension_n`.
        """
        random = generator(seed, source, "device")
        device = self.mounted(random)
        _, flexure = sampled(s2_initialisation(), self.command_rate_hz)
        # The papers' flexure is for 6 mm of travel; another device is flexed over all of its own.
        flexure = flexure * (device.commands[1] / flexure.max())
        rest = np.zeros(round(self.rest_s * self.command_rate_hz))
        _, motion = sampled(excitation, self.command_rate_hz)
        commands = np.concatenate([flexure, rest, motion])
        done = device.advance(device.virgin(), commands, 1 / self.command_rate_hz, random)
        angle, x, y = self.tracker(done.angle, random)
        channels = {"x_mm": x, "y_mm": y, "displacement_mm": done.actuator, "tension_n": done.tension}
        skipped = 0 if self.keep_flexure else flexure.size + rest.size
        log = Trial(
            np.arange(commands.size - skipped) / self.command_rate_hz,
            commands[skipped:],
            angle[skipped:],
            {name: values[skipped:] for name, values in channels.items()},
            Units(command=device.command_unit),
            source,
        )
        return resample(log, self.rate_hz)


@dataclass(frozen=True)
class TendonVariation(Quantities):
    """Variation of the device between trials: standard deviations of normal draws.

    S2 accepts a pretension when the standard deviation over trials is below 0.5 deg.
    """

    offset_deg: float = quantity(0.3, "deg", 0.0, 10.0, "shift of all angles")
    slope: float = quantity(0.004, "1", 0.0, 0.2, "relative change of both slopes")
    friction: float = quantity(0.04, "1", 0.0, 0.3, "relative change of the friction")

    def __call__(self, parameters: TendonParameters, random: np.random.Generator) -> TendonParameters:
        """The device of one trial."""
        offset, slope, friction = random.standard_normal(3)
        return replace(
            parameters,
            offset_deg=parameters.offset_deg + self.offset_deg * offset,
            loading_slope=parameters.loading_slope * (1 + self.slope * slope),
            unloading_slope=parameters.unloading_slope * (1 + self.slope * slope),
            friction=parameters.friction * (1 + self.friction * friction),
        )


@final
@dataclass(frozen=True, kw_only=True)
class TendonRecorder(TrackedBench):
    """Recorder on the bench of S2."""

    device: TendonParameters = field(default_factory=TendonParameters)
    variation: TendonVariation = field(default_factory=TendonVariation)

    def mounted(self, random: np.random.Generator) -> Device:
        return TendonCatheter(self.variation(self.device, random))
