"""Catheter of S1 and its bench: valve, bladder, braid friction and a segment that stiffens."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, final

import numpy as np

from hystmpc.models.maps import LaserConversion
from hystmpc.sim.devices.device import DeviceMotion, NamedDevice, Quantities, quantity
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..library import laboratory
from .recorder import generator, quantised, sampled

STATES = 5
_STEP_S = 1e-3  # longest step of the recursion


class MuscleNumbers(NamedTuple):
    """Parameters of the recursion in c/muscle.c, in its order; see `MuscleParameters`."""

    supply_bar: float
    valve_s: float
    fill_s: float
    vent_s: float
    slack_bar: float
    slack_width_bar: float
    friction: float
    presliding_bar: float
    greatest_deg: float
    half_bar: float
    late: float
    late_share: float
    bend_share: float


@dataclass(frozen=True)
class MuscleParameters(Quantities):
    """Parameters of the muscle-driven catheter.

    S1 prints none of them; docs/reference/devices.md says how they were set.
    """

    greatest_bar: float = quantity(3.0, "bar", 0.1, 20.0, "greatest pressure (S1)")
    supply_bar: float = quantity(5.0, "bar", 0.2, 30.0, "supply of the valve")
    valve_s: float = quantity(0.025, "s", 2e-3, 10.0, "time constant of the valve's pressure control")
    fill_s: float = quantity(0.30, "s", 1e-3, 10.0, "filling through the open valve, towards the supply")
    vent_s: float = quantity(0.20, "s", 1e-3, 10.0, "venting through the open valve, towards 0 bar")
    slack_bar: float = quantity(0.65, "bar", 0.0, 5.0, "pressure at which the bladder meets the braid")
    slack_width_bar: float = quantity(0.08, "bar", 1e-3, 2.0, "how gradually it does")
    friction: float = quantity(0.12, "1", 0.0, 0.9, "braid and cable friction over pull, each way")
    presliding_bar: float = quantity(0.15, "bar", 1e-3, 5.0, "pressure over which friction turns its side")
    greatest_deg: float = quantity(45.0, "deg", 1.0, 360.0, "angle that no pressure exceeds")
    half_bar: float = quantity(0.9, "bar", 0.01, 100.0, "pull that gives half of it")
    late: float = quantity(0.05, "1", 0.0, 1.0, "share of the angle that follows late")
    late_s: float = quantity(0.4, "s", 1e-3, 100.0, "time constant of that share")
    bend_lag_s: float = quantity(0.01, "s", 0.0, 10.0, "first-order lag of the segment")


@dataclass(frozen=True)
class MuscleVariation(Quantities):
    """Variation of the device between recordings: standard deviations of normal draws."""

    gain: float = quantity(0.005, "1", 0.0, 0.2, "relative change of the greatest angle")
    friction: float = quantity(0.03, "1", 0.0, 0.3, "relative change of the friction")
    slack_bar: float = quantity(0.005, "bar", 0.0, 0.5, "shift of the slack")

    def __call__(self, parameters: MuscleParameters, random: np.random.Generator) -> MuscleParameters:
        """The device of one recording."""
        gain, friction, slack = random.standard_normal(3)
        return replace(
            parameters,
            greatest_deg=parameters.greatest_deg * (1 + self.gain * gain),
            friction=parameters.friction * (1 + self.friction * friction),
            slack_bar=parameters.slack_bar + self.slack_bar * slack,
        )


@final
class MuscleCatheter:
    """Pressure command [bar] to tip angle [deg] of a catheter bent by a pneumatic artificial muscle.

        p'     = (u - p) / valve, within [-p / vent, (supply - p) / fill]      valve: fills faster than it vents
        b      = s ln(1 + e^((p - slack) / s)), shifted to be 0 at p = 0        bladder slack: dead band at the bottom
        z'     = (sign(b') - z) |b'| / presliding                               Dahl friction, -1 <= z <= 1
        q      = b (1 - friction z)                                             pull at the tip
        theta* = greatest q / (q + half)                                        k theta = g q (1 - theta / greatest)
        theta  = theta* through a late share of the angle and the segment's lag

    The valve makes the loop wider with frequency; venting grows slow towards 0 bar, so that fast loops do not reach
    their bottom. Saturation comes from the muscle, whose force falls as it shortens.

    State (5,): pressure [bar], b [bar], z, late angle [deg], angle [deg]. Sources of the effects: S1 sec. II-B, III.
    """

    command_unit = "bar"

    def __init__(self, parameters: MuscleParameters | None = None) -> None:
        self.parameters = parameters or MuscleParameters()
        self._packed = (0.0, np.empty(0))  # the last step, and the numbers for it

    @property
    def commands(self) -> tuple[float, float]:
        """Least and greatest command [bar]."""
        return 0.0, self.parameters.greatest_bar

    @property
    def state_size(self) -> int:
        """S = 5."""
        return STATES

    def virgin(self) -> Vec:
        """State (5,) of the straight, vented catheter."""
        return np.array([0.0, 0.0, -1.0, 0.0, 0.0])

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> DeviceMotion:
        """Run commands (T,) [bar], each held for `dt_s` [s]; see `Device.advance`. Draws nothing from `random`."""
        del random
        after = np.array(state, dtype=np.float64)
        clipped = np.clip(np.asarray(commands, dtype=np.float64), *self.commands)
        angle, drive = np.empty(clipped.size), np.empty(clipped.size)
        parts = max(math.ceil(dt_s / _STEP_S - 1e-9), 1)
        if self._packed[0] != dt_s / parts:
            self._packed = dt_s / parts, np.array(self._numbers(dt_s / parts), dtype=np.float64)
        laboratory().muscle(after, clipped, clipped.size, self._packed[1], dt_s, parts, angle, drive)
        return DeviceMotion(angle, drive, np.full(clipped.size, np.nan), after)

    def _numbers(self, step_s: float) -> MuscleNumbers:
        p = self.parameters
        return MuscleNumbers(
            supply_bar=p.supply_bar,
            valve_s=p.valve_s,
            fill_s=p.fill_s,
            vent_s=p.vent_s,
            slack_bar=p.slack_bar,
            slack_width_bar=p.slack_width_bar,
            friction=p.friction,
            presliding_bar=p.presliding_bar,
            greatest_deg=p.greatest_deg,
            half_bar=p.half_bar,
            late=p.late,
            late_share=1 - math.exp(-step_s / p.late_s),
            bend_share=1 - math.exp(-step_s / p.bend_lag_s) if p.bend_lag_s > 0 else 1.0,
        )


@dataclass(frozen=True)
class LaserSensor(Quantities):
    """Laser distance sensor of S1 at the tip, read by a converter: voltage from true angle (S1 eq. (2)-(4)).

    S1 prints neither noise nor resolution: 0.02 mm (0.04 deg near straight), and the 9.8 mV (0.04 mm) of a 10 V range
    on the 10 bits of its Arduino.
    """

    straight_mm: float = quantity(60.0, "mm", 0.0, 1000.0, "distance to the tip of the straight catheter")
    noise_mm: float = quantity(0.02, "mm", 0.0, 10.0, "standard deviation of the noise of the distance")
    quantisation_v: float = quantity(10.0 / 2**10, "V", 0.0, 10.0, "step of the converter")
    conversion: LaserConversion = field(default_factory=LaserConversion)

    def __call__(self, angle_deg: Vec, random: np.random.Generator) -> Vec:
        """Voltage [V] at true angles (T,) [deg]."""
        distance = self.straight_mm - self.conversion.displacement(angle_deg)
        noisy = distance + self.noise_mm * random.standard_normal(angle_deg.size)
        return quantised(self.conversion.voltage(noisy), self.quantisation_v)


@dataclass(frozen=True)
class MuscleRecorder(Quantities):
    """Recorder on the bench of S1.

    S1 eq. (3) takes the greatest distance of a group as that of the straight catheter. A motion that never comes to
    0 bar (test (b)) has no such sample, so the group here begins with the catheter straight at 0 bar and a ramp to
    the first command; both count for eq. (3) and are then left out of the trial. `straight="group"` takes the
    greatest distance of the trial itself, to the letter of eq. (3). As a maximum of noisy samples it lies some noise
    above the true one, in the papers as here.

    Attributes:
        rate_hz: rate of command, laser and trial [Hz].
        rest_s: time at 0 bar before, time of the ramp to the first command, and of the hold there [s].
        straight: what the straight catheter's distance is taken from: `rest` (and trial) or `group` (trial alone).
    """

    device: MuscleParameters = field(default_factory=MuscleParameters)
    variation: MuscleVariation = field(default_factory=MuscleVariation)
    laser: LaserSensor = field(default_factory=LaserSensor)
    rate_hz: float = quantity(250.0, "Hz", 1.0, 10_000.0, "rate of command and laser (S1 for the laser)")
    rest_s: float = quantity(1.0, "s", 0.0, 1000.0, "time straight, of the ramp, and of the hold before the motion")
    straight: Literal["rest", "group"] = "rest"

    def record(self, excitation: Trajectory, seed: int, source: str) -> Trial:
        """Record one trial; equal seed and source give equal trials, others another device and noise.

        Channels: `voltage_v` of the laser, `pressure_bar` in the muscle.
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


DEVICE = NamedDevice("muscle", MuscleCatheter, MuscleParameters, ("friction", "slack_bar", "greatest_deg", "half_bar"))
"""The entry of `hystmpc.devices`."""
