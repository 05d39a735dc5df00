"""Rod catheter: a planar rod on a tendon with friction, its parameters, its recorder, and single trials of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.sim.devices.device import Device, DeviceMotion, NamedDevice, Quantities, quantity
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from . import rod_solver
from .recorder import EmTracker, TrackedBench
from .rod_solver import RodNumbers, StepNumbers, packed

_SINKING = 0.5  # greatest weight moment over stiffness: beyond, a rod buckles under its own weight
_PULL = 40  # steps in which the virgin tendon is tensioned
_PULL_DT_S = 1e6  # a pull slow against every relaxation


@dataclass(frozen=True)
class RodParameters(Quantities):
    """Parameters of the rod device; the defaults were identified, see docs/reference/devices.md.

    They are altered by `dataclasses.replace`.

    Raises:
        ConfigError: if a number is out of its bounds, the branches' shares leave no stiffness at rest, or the weight
            is too much for the stiffness.
    """

    travel_mm: float = quantity(6.0, "mm", 0.1, 100.0, "greatest tendon displacement (S2)")
    rest_deg: float = quantity(-8.529, "deg", -90.0, 120.0, "bend of the rod without tendon and history")
    length_mm: float = quantity(60.0, "mm", 1.0, 1000.0, "length of the rod (steerable part of the recorded device)")
    offset_mm: float = quantity(1.7926, "mm", 0.1, 20.0, "distance of the lumen from the rod's axis")
    stiffness_nmm: float = quantity(6.8951, "N mm/rad", 1e-2, 1e5, "bending stiffness of the whole rod at rest, EI / l")
    shaft_n_per_mm: float = quantity(6.1229, "N/mm", 1e-2, 1e5, "stiffness of tendon against shaft, EA / free length")
    rod_n_per_mm: float = quantity(1.2711, "N/mm", 1e-2, 1e5, "stiffness of the tendon within the rod")
    pretension_mm: float = quantity(3.6194, "mm", -20.0, 20.0, "pull that tensions the virgin tendon; below 0 is slack")
    friction: float = quantity(0.05, "1", 0.0, 0.6, "coefficient of friction of tendon and lumen")
    shaft_bend_deg: float = quantity(30.0, "deg", 0.0, 720.0, "wrap angle of the passive shaft")
    shaft_drag_n: float = quantity(1.6638, "N", 0.0, 1000.0, "drag in the shaft that does not come from tension")
    rod_drag_n: float = quantity(1.5684, "N", 0.0, 1000.0, "the same in the rod")
    fast_share: float = quantity(1.0, "1", 0.0, 10.0, "stiffness of the first Maxwell branch over that at rest")
    fast_s: float = quantity(0.04784, "s", 1e-3, 1e4, "its relaxation time")
    slow_share: float = quantity(0.07096, "1", 0.0, 10.0, "stiffness of the second Maxwell branch over that at rest")
    slow_s: float = quantity(1.9418, "s", 1e-3, 1e4, "its relaxation time")
    set_share: float = quantity(0.11839, "1", 0.0, 0.9, "share of the greatest bend so far that stays: first flexure")
    weight_n: float = quantity(0.0, "N", 0.0, 100.0, "weight of the rod, evenly along it")
    down_deg: float = quantity(0.0, "deg", -360.0, 360.0, "from the rod's base axis to the pull of gravity")
    drive_lag_s: float = quantity(0.02, "s", 0.0, 10.0, "first-order lag of the servo drive")
    mount_deg: float = quantity(0.0, "deg", -60.0, 60.0, "shift of all angles by how the rod is mounted")
    longest_step_s: float = quantity(0.05, "s", 1e-4, 10.0, "longer samples are solved in equal parts")
    shaft_contacts: int = quantity(5, "1", 1, 50, "contacts of tendon and shaft")
    segments: int = quantity(10, "1", 1, 50, "segments of the rod, with a contact each")

    def __post_init__(self) -> None:
        super().__post_init__()
        for f in fields(self):
            if f.type == "float":  # the kernel is compiled for floats: a 2 is a 2.0
                object.__setattr__(self, f.name, float(getattr(self, f.name)))
        if self.weight_n * self.length_mm > _SINKING * self.stiffness_nmm:
            raise ConfigError(
                f"RodParameters.weight_n: got {self.weight_n} N, expected at most "
                f"{_SINKING * self.stiffness_nmm / self.length_mm:.3g} N on a rod of this stiffness and length"
            )

    @property
    def contacts(self) -> int:
        """Number m of contacts of the tendon in shaft and rod."""
        return self.shaft_contacts + self.segments

    def numbers(self) -> RodNumbers:
        """Parameters in the form of the equations."""
        p, n = self.shaft_contacts, self.segments
        stiffness = self.stiffness_nmm * n
        shaft, rod = (p + 1) * self.shaft_n_per_mm, n * self.rod_n_per_mm
        return RodNumbers(
            mu=self.friction,
            offset=self.offset_mm,
            rest=math.radians(self.rest_deg) / n,
            stiffness=stiffness,
            branch_stiffness=(self.fast_share * stiffness, self.slow_share * stiffness),
            set_share=self.set_share,
            pretension=self.pretension_mm,
            weight=self.weight_n / n,
            length=self.length_mm / n,
            down=math.radians(self.down_deg),
            compliance=np.repeat([1 / shaft, 1 / rod], [p + 1, n]),
            wrap=np.repeat([0.0, math.radians(self.shaft_bend_deg) / p, 0.0], [1, p, n]),
            drag=np.repeat([0.0, self.shaft_drag_n / p, self.rod_drag_n / n], [1, p, n]),
            shaft_contacts=p,
            segments=n,
        )

    def step_numbers(self, dt_s: float) -> StepNumbers:
        """Constants of a step; exact for bends that change evenly within it."""
        times = (self.fast_s, self.slow_s)
        keep = tuple(math.exp(-dt_s / tau) for tau in times)
        mean = tuple(-math.expm1(-dt_s / tau) * tau / dt_s for tau in times)
        return StepNumbers(
            keep=(keep[0], keep[1]),
            old=(mean[0] - keep[0], mean[1] - keep[1]),
            new=(1 - mean[0], 1 - mean[1]),
            drive_share=-math.expm1(-dt_s / self.drive_lag_s) if self.drive_lag_s > 0 else 1.0,
        )


@dataclass(frozen=True)
class RodVariation(Quantities):
    """Variation of the device between trials: standard deviations of normal draws."""

    mount_deg: float = quantity(0.3, "deg", 0.0, 10.0, "shift of all angles")
    pretension_mm: float = quantity(0.02, "mm", 0.0, 1.0, "change of the pretension")
    friction: float = quantity(0.04, "1", 0.0, 0.3, "relative change of friction and drags")

    def __call__(self, parameters: RodParameters, random: np.random.Generator) -> RodParameters:
        """The device of one trial."""
        mount, pretension, friction = random.standard_normal(3)
        scale = 1 + self.friction * friction
        return replace(
            parameters,
            mount_deg=parameters.mount_deg + self.mount_deg * mount,
            pretension_mm=parameters.pretension_mm + self.pretension_mm * pretension,
            friction=parameters.friction * scale,
            shaft_drag_n=parameters.shaft_drag_n * scale,
            rod_drag_n=parameters.rod_drag_n * scale,
        )


@final
class RodCatheter:
    """Tendon displacement [mm] to tip angle [deg] of a rod of n segments, bent by a tendon with friction in its lumen.

    The tendon runs from the drive through a passive, curved shaft and the rod to the tip. It is elastic and can only
    pull; at m contacts along its way it sticks or slips by the capstan law, each with a memory of its own. The rod's
    segments are standard linear solids, and the first flexure leaves them a set. Equations and one step:
    c/rod.c. The sources are those of tendon-sheath mechanics: Kaneko et al., IEEE T-RA 7 (1991), elastic
    tendon in a capstan; Agrawal et al., IEEE T-RO 26 (2010), its lumps in series; and for the rod Rucker and Webster,
    IEEE T-RO 27 (2011), whose planar case at a constant offset is the moment offset x tension.

    State (1 + 2 m + 4 n,): drive and displacements of the tendon at the contacts [mm], which way each slipped last;
    bends, what the two Maxwell branches remember, and the greatest bends so far [rad].
    """

    command_unit = "mm"

    def __init__(self, parameters: RodParameters | None = None) -> None:
        self.parameters = parameters or RodParameters()
        self._numbers = self.parameters.numbers()
        self._packed = (0.0, np.empty(0))  # the last step, and the numbers for it
        self.residual_mm = 0.0
        """Greatest residual of the friction law in all steps so far [mm]; see `rod_solver.TOLERANCE_MM`."""

    @property
    def commands(self) -> tuple[float, float]:
        """Least and greatest command [mm]."""
        return 0.0, self.parameters.travel_mm

    @property
    def state_size(self) -> int:
        """S = 1 + 2 m + 4 n."""
        return 1 + 2 * self.parameters.contacts + 4 * self.parameters.segments

    def virgin(self) -> Vec:
        """State (S,) at 0 mm, after the tendon was tensioned by pulling and before any flexure."""
        p = self.parameters
        state = np.zeros(self.state_size)
        state[1 + 2 * p.contacts :] = math.radians(p.rest_deg) / p.segments
        state[0] = -p.pretension_mm
        pull = np.linspace(-p.pretension_mm, 0.0, _PULL)
        return self._run(state, pull, _PULL_DT_S, 1).state

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> DeviceMotion:  # noqa: ARG002
        """Run commands (T,) [mm], each held for `dt_s` [s]; see `Device.advance`. Nothing here is random."""
        clipped = np.clip(np.asarray(commands, dtype=np.float64), *self.commands)
        parts = max(math.ceil(dt_s / self.parameters.longest_step_s - 1e-9), 1)
        return self._run(np.array(state, dtype=np.float64), clipped, dt_s / parts, parts)

    def tensions(self, state: Vec) -> Vec:
        """Tension of the tendon behind the drive and behind each contact, shaft first (m + 1,) [N]."""
        p = self.parameters
        places = np.concatenate([[state[0] + p.pretension_mm], state[1 : 1 + p.contacts], [0.0]])
        stretch = -np.diff(places)
        stretch[1 + p.shaft_contacts :] -= p.offset_mm * (self.bends(state) - self._numbers.rest)
        return np.maximum(stretch / self._numbers.compliance, 0.0)

    def bends(self, state: Vec) -> Vec:
        """Bends of the segments from base to tip (n,) [rad]."""
        begin = 1 + 2 * self.parameters.contacts
        return np.array(state[begin : begin + self.parameters.segments])

    def _run(self, state: Vec, commands: Vec, step_s: float, parts: int) -> DeviceMotion:
        p = self.parameters
        angle, drive, tension = (np.empty(commands.size) for _ in range(3))
        if self._packed[0] != step_s:
            self._packed = step_s, packed(self._numbers, p.step_numbers(step_s))
        residual = rod_solver.advance(state, commands, self._numbers, self._packed[1], parts, angle, drive, tension)
        self.residual_mm = max(self.residual_mm, float(residual))
        return DeviceMotion(angle + p.mount_deg, drive, tension, state)


@final
@dataclass(frozen=True, kw_only=True)
class RodRecorder(TrackedBench):
    """Recorder on the bench of S2 with a rod in the catheter's place."""

    device: RodParameters = field(default_factory=RodParameters)
    variation: RodVariation = field(default_factory=RodVariation)

    def mounted(self, random: np.random.Generator) -> Device:
        return RodCatheter(self.variation(self.device, random))


@dataclass(frozen=True, eq=False)
class RodTrial:
    """Result of one run of the rod.

    Attributes:
        motion: true angle [deg], drive [mm] and tension [N], all (T,), and the state after it; a further trial of the
            same device starts there.
        measured: what the tracker says [deg], (T,).
        residual_mm: greatest residual of the friction law in any step; see `rod_solver.TOLERANCE_MM`.
    """

    motion: DeviceMotion
    measured: Vec
    residual_mm: float

    @property
    def true(self) -> Vec:
        """Tip angle without any sensor [deg], (T,)."""
        return self.motion.angle


@dataclass(frozen=True)
class RodBench:
    """Rod with its tracker.

    Attributes:
        device: numbers of the rod; alter them with `dataclasses.replace`.
    """

    device: RodParameters = field(default_factory=RodParameters)
    tracker: EmTracker = field(default_factory=EmTracker)

    def run(self, commands: ArrayLike, dt_s: float, seed: int = 0, state: Vec | None = None) -> RodTrial:
        """Run commands (T,) [mm], each held for `dt_s` [s], from `state` or a virgin device.

        Equal arguments give equal trials. `seed` is of the tracker's noise; the rod itself has nothing random.

        Raises:
            ConfigError: if commands are not one row of finite numbers, the sample time is not positive, or the state
                is that of another device.
        """
        u = np.asarray(commands, dtype=np.float64)
        if u.ndim != 1 or u.size == 0 or not np.isfinite(u).all():
            raise ConfigError(f"commands: got shape {u.shape}, expected (T,) finite numbers [mm], T >= 1")
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number [s]")
        rod = RodCatheter(self.device)
        start = rod.virgin() if state is None else np.asarray(state, dtype=np.float64)
        if start.shape != (rod.state_size,):
            raise ConfigError(f"state: got shape {start.shape}, expected ({rod.state_size},)")
        random = np.random.default_rng(seed)
        motion = rod.advance(start, u, dt_s, random)
        measured, _, _ = self.tracker(motion.angle, random)
        return RodTrial(motion, measured, rod.residual_mm)


def simulate_rod(parameters: RodParameters, commands: ArrayLike, dt_s: float, seed: int = 0) -> tuple[Vec, Vec]:
    """True and measured tip angle, both (T,) [deg], of a virgin rod under commands (T,) [mm]; see `RodBench.run`.

    Raises:
        ConfigError: through `RodBench.run`.
    """
    trial = RodBench(parameters).run(commands, dt_s, seed)
    return trial.true, trial.measured


DEVICE = NamedDevice(
    "rod",
    RodCatheter,
    RodParameters,
    ("friction", "shaft_drag_n", "rod_drag_n", "stiffness_nmm", "shaft_n_per_mm", "rod_n_per_mm", "set_share"),
)
"""The entry of `hystmpc.devices`."""
