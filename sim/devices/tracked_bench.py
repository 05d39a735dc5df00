"""How a trial is taken on S2's bench: initialisation flexure, motion, tracker, log at 100 Hz, resampled to 25 Hz."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from hystmpc.trajectories.excitation import s2_initialisation
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units, resample

from .device import Device
from .excited import generator, sampled
from .quantities import check_quantities, quantity
from .sensors import EmTracker


@dataclass(frozen=True, kw_only=True)
class TrackedBench(ABC):
    """The bench of S2, whatever device is on it.

    Every trial begins with a virgin device, the initialisation flexure (0.1 Hz to the end of the travel and back)
    and a rest at 0 mm, which are discarded as S2's protocol says unless `keep_flexure`.

    Attributes:
        tracker: the sensor on the device's tip.
        command_rate_hz: rate of command and log [Hz].
        rate_hz: rate of the trial, by linear interpolation [Hz].
        rest_s: rest between flexure and motion [s].
        keep_flexure: leave flexure and rest in the trial.

    Raises:
        ConfigError: if a number is out of its bounds.
    """

    tracker: EmTracker = field(default_factory=EmTracker)
    command_rate_hz: float = quantity(100.0, "Hz", 1.0, 10_000.0, "rate of command and log (S2's code)")
    rate_hz: float = quantity(25.0, "Hz", 1.0, 10_000.0, "rate of the trial (S2)")
    rest_s: float = quantity(2.0, "s", 0.0, 1000.0, "rest between flexure and motion")
    keep_flexure: bool = False

    def __post_init__(self) -> None:
        check_quantities(self)

    @abstractmethod
    def mounted(self, random: np.random.Generator) -> Device:
        """The device of one trial, varied as devices vary from trial to trial."""

    def record(self, excitation: Trajectory, seed: int, source: str) -> Trial:
        """One trial; equal seed and source give equal trials, either of them another gives another device and noise.

        Channels: `x_mm`, `y_mm` of the tip, `displacement_mm` that the drive reached, `tension_n`.

        Raises:
            ConfigError: through `resample`, if the log's rate is too low for the trial's.
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
