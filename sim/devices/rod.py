"""The rod catheter: a planar rod on a tendon with friction, its recorder, and single trials of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from . import rod_solver
from .device import Device, DeviceMotion
from .recorder import EmTracker, TrackedBench
from .rod_equations import new_knots
from .rod_parameters import RodParameters, RodVariation
from .rod_solver import new_work

_PULL = 40  # steps in which the virgin tendon is tensioned
_PULL_DT_S = 1e6  # a pull slow against every relaxation


@final
class RodCatheter:
    """Tendon displacement [mm] to tip angle [deg] by a rod of n segments, bent by a tendon that rubs in its lumen.

    The tendon runs from the drive through a passive, curved shaft and the rod to the tip. It is elastic and can only
    pull; at m contacts along its way it sticks or slips by the capstan law, each with a memory of its own. The rod's
    segments are standard linear solids, and the first flexure leaves them a set. Equations: `rod_equations`; one
    step: `rod_solver`. The sources are those of tendon-sheath mechanics: Kaneko et al., IEEE T-RA 7 (1991), elastic
    tendon in a capstan; Agrawal et al., IEEE T-RO 26 (2010), its lumps in series; and for the rod Rucker and Webster,
    IEEE T-RO 27 (2011), whose planar case at a constant offset is the moment offset x tension.

    State (1 + 2 m + 4 n,): drive and displacements of the tendon at the contacts [mm], which way each slipped last;
    bends, what the two Maxwell branches remember, and the greatest bends so far [rad].
    """

    command_unit = "mm"

    def __init__(self, parameters: RodParameters | None = None) -> None:
        self.parameters = parameters or RodParameters()
        self._numbers = self.parameters.numbers()
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
        numbers, step, work, knots = self._numbers, p.step_numbers(step_s), new_work(p.contacts), new_knots(p.contacts)
        residual = rod_solver.advance(state, commands, numbers, step, parts, work, knots, angle, drive, tension)
        self.residual_mm = max(self.residual_mm, float(residual))
        return DeviceMotion(angle + p.mount_deg, drive, tension, state)


@final
@dataclass(frozen=True, kw_only=True)
class RodRecorder(TrackedBench):
    """The bench of S2 with a rod in the catheter's place."""

    device: RodParameters = field(default_factory=RodParameters)
    variation: RodVariation = field(default_factory=RodVariation)

    def mounted(self, random: np.random.Generator) -> Device:
        return RodCatheter(self.variation(self.device, random))


@dataclass(frozen=True, eq=False)
class RodTrial:
    """One run.

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
    """A rod and its tracker.

    Attributes:
        device: numbers of the rod; alter them with `dataclasses.replace`.
    """

    device: RodParameters = field(default_factory=RodParameters)
    tracker: EmTracker = field(default_factory=EmTracker)

    def run(self, commands: ArrayLike, dt_s: float, seed: int = 0, state: Vec | None = None) -> RodTrial:
        """Commands (T,) [mm], each held for `dt_s` [s], from `state` or a virgin device.

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
