"""A planar rod on a tendon as a simulated device: physics that no operator of this package contains."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from . import rod_kernel
from .device import Motion
from .rod_parameters import RodParameters
from .rod_shooting import new_knots
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

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> Motion:  # noqa: ARG002
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

    def _run(self, state: Vec, commands: Vec, step_s: float, parts: int) -> Motion:
        p = self.parameters
        angle, drive, tension = (np.empty(commands.size) for _ in range(3))
        numbers, step, work, knots = self._numbers, p.step_numbers(step_s), new_work(p.contacts), new_knots(p.contacts)
        residual = rod_kernel.advance(state, commands, numbers, step, parts, work, knots, angle, drive, tension)
        self.residual_mm = max(self.residual_mm, float(residual))
        return Motion(angle + p.mount_deg, drive, tension, state)
