"""How a recording of S1 is taken: straight at 0 bar, up to the motion's start, motion, laser at 250 Hz."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units

from .excited import generator, sampled
from .muscle import MuscleCatheter, MuscleParameters, MuscleVariation
from .quantities import check_quantities, quantity
from .sensors import LaserSensor


@dataclass(frozen=True)
class MuscleRecorder:
    """The bench of S1.

    S1 eq. (3) takes the greatest distance of a group as that of the straight catheter. A motion that never comes to
    0 bar (test (b)) has no such sample, so the group here begins with the catheter straight at 0 bar and a ramp to
    the first command; both count for eq. (3) and are then left out of the trial. `straight="group"` takes the
    greatest distance of the trial itself, to the letter of eq. (3). As a maximum of noisy samples it lies some noise
    above the true one, in the papers as here.

    Attributes:
        device: the catheter.
        variation: how it differs from recording to recording.
        laser: the sensor beside its tip.
        rate_hz: rate of command, laser and trial [Hz].
        rest_s: time at 0 bar before, time of the ramp to the first command, and of the hold there [s].
        straight: what the straight catheter's distance is taken from: `rest` (and trial) or `group` (trial alone).

    Raises:
        ConfigError: if a number is out of its bounds.
    """

    device: MuscleParameters = field(default_factory=MuscleParameters)
    variation: MuscleVariation = field(default_factory=MuscleVariation)
    laser: LaserSensor = field(default_factory=LaserSensor)
    rate_hz: float = quantity(250.0, "Hz", 1.0, 10_000.0, "rate of command and laser (S1 for the laser)")
    rest_s: float = quantity(1.0, "s", 0.0, 1000.0, "time straight, of the ramp, and of the hold before the motion")
    straight: Literal["rest", "group"] = "rest"

    def __post_init__(self) -> None:
        check_quantities(self)

    def record(self, excitation: Trajectory, seed: int, source: str) -> Trial:
        """One trial; equal seed and source give equal trials, either of them another gives another device and noise.

        Channels: `voltage_v` of the laser, `pressure_bar` in the muscle.

        Raises:
            ModelError: if the device bends beyond what the laser can tell.
        """
        random = generator(seed, source, "device")
        device = MuscleCatheter(self.variation(self.device, random))
        t, motion = sampled(excitation, self.rate_hz)
        steps = round(self.rest_s * self.rate_hz)
        before = (np.zeros(steps), np.linspace(0, motion[0], steps), np.full(steps, motion[0]))
        commands = np.concatenate([*before, motion])
        done = device.advance(device.virgin(), commands, 1 / self.rate_hz, random)
        voltage = self.laser(done.angle, random)
        conversion, start = self.laser.conversion, 3 * steps
        group = voltage if self.straight == "rest" else voltage[start:]
        straight_mm = float(conversion.distance(group).max())
        angle = conversion.angles_of_group(voltage[start:], straight_mm)
        channels = {"voltage_v": voltage[start:], "pressure_bar": done.actuator[start:]}
        return Trial(t, motion, angle, channels, Units(command=device.command_unit), source)
