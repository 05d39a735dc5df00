"""Device core of the blind cases: a rod of viscoelastic segments on an elastic tendon that can only pull."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import final

import numpy as np

from hystmpc.sim.devices import rod_kernel
from hystmpc.sim.devices.rod import RodCatheter
from hystmpc.sim.devices.rod_parameters import RodParameters
from hystmpc.sim.devices.rod_shooting import new_knots
from hystmpc.sim.devices.rod_solver import new_work
from hystmpc.trials.types import Vec

from .core import STROKE, TRAVEL_MM, Core, Mounting
from .scene import FINE_S

_COARSE = 10  # fine steps in one of the rod, whose equations take a hundred times as long as those of the others
_SETTLED_S = 1e6  # a step slow against every relaxation
_BEFORE = 40
_SHAFT, _SEGMENTS = 3, 6


@final
@dataclass(frozen=True)
class RodCore(Core):
    """Rod of `hystmpc.sim.devices.rod` on a coarser grid, with its drive, its first flexure and its sensor taken out.

    Its segments are standard linear solids: what they relax belongs to the device that the simulator is identified on,
    as every device bends a little late. The numbers are drawn so that this stays within what a backlash or a few plays
    leave of the friction anyway; more of it would be creep, a withheld effect.

    Attributes:
        gain: tip angle over the way of the tendon in the rod [deg/mm].
        offset_deg: angle of the rod at rest, without tendon [deg].
        friction: coefficient of tendon and lumen.
        drag_n: friction of either part, shaft and rod, that does not come from tension [N].
        stiffness_nmm: bending stiffness at rest [N mm/rad].
        pretension_mm: pull that tensions the virgin tendon [mm].
        fast_share, slow_share: stiffness of the Maxwell branches over that at rest.
        slow_s: relaxation time of the slow branch [s].
    """

    gain: float = 32.0
    offset_deg: float = -8.5
    friction: float = 0.06
    drag_n: float = 1.2
    stiffness_nmm: float = 6.9
    pretension_mm: float = 3.6
    fast_share: float = 0.15
    slow_share: float = 0.012
    slow_s: float = 2.0

    def run(self, x: Vec, scale: Vec) -> Vec:
        """Angles between the rod's coarser steps lie on straight lines; see `Core.run`."""
        last = -(-(x.size - 1) // _COARSE) * _COARSE
        times, knots = np.arange(x.size), np.arange(0, last + 1, _COARSE)
        places, factors = (np.interp(knots, times, signal) for signal in (x, scale))
        ways = _ways(replace(self, gain=1.0, offset_deg=0.0), places.tobytes(), factors.tobytes())
        return self.offset_deg + self.gain * np.interp(times, knots, ways)

    def mounted(self, mounting: Mounting) -> RodCore:
        """The friction of the lumen and its drag go together; see `Core.mounted`."""
        return replace(
            self,
            gain=self.gain * mounting.gain,
            friction=self.friction * mounting.friction,
            drag_n=self.drag_n * mounting.friction,
            offset_deg=self.offset_deg + mounting.offset_deg,
        )

    @classmethod
    def draw(cls, random: np.random.Generator) -> RodCore:
        """A device of this kind."""
        return cls(
            gain=random.uniform(28, 38),
            offset_deg=random.uniform(-20, 5),
            friction=random.uniform(0.03, 0.09),
            drag_n=random.uniform(0.6, 1.6),
            stiffness_nmm=random.uniform(5.5, 8.5),
            pretension_mm=random.uniform(3.0, 4.5),
            fast_share=random.uniform(0.05, 0.25),
            slow_share=random.uniform(0.005, 0.02),
            slow_s=random.uniform(1.0, 4.0),
        )

    def rod(self) -> RodParameters:
        """The numbers of the simulated rod."""
        return RodParameters(
            rest_deg=0.0,
            stiffness_nmm=self.stiffness_nmm,
            pretension_mm=self.pretension_mm,
            friction=self.friction,
            shaft_drag_n=self.drag_n,
            rod_drag_n=self.drag_n,
            fast_share=self.fast_share,
            slow_share=self.slow_share,
            slow_s=self.slow_s,
            set_share=0.0,
            drive_lag_s=0.0,
            shaft_contacts=_SHAFT,
            segments=_SEGMENTS,
        )


@lru_cache(maxsize=64)
def _ways(core: RodCore, places: bytes, factors: bytes) -> Vec:
    """Way of the tendon in the rod (K,) [mm] for places of the drive (K,) [mm] and friction factors (K,), as bytes.

    Kept, for effects behind the rod are sized and recorded on one and the same motion of it.
    """
    x, scale = (np.frombuffer(data).copy() for data in (places, factors))  # writable, as the kernel is compiled for
    rod, stroke = core.rod(), STROKE * TRAVEL_MM
    before = np.concatenate([np.linspace(0.0, stroke, _BEFORE), np.linspace(stroke, x[0], _BEFORE)])
    state = RodCatheter(rod).virgin()
    _bends(rod, state, before, np.full(before.size, scale[0]), _SETTLED_S)
    ways = np.radians(_bends(rod, state, x, scale, _COARSE * FINE_S)) * rod.offset_mm
    ways.setflags(write=False)
    return ways


def _bends(rod: RodParameters, state: Vec, places: Vec, factors: Vec, step_s: float) -> Vec:
    """Bend (K,) [deg] at the end of every step; `state` is moved on. The kernel takes one friction a call."""
    bend, drive, tension = (np.empty(places.size) for _ in range(3))
    step, work, knots, whole = rod.step_numbers(step_s), new_work(rod.contacts), new_knots(rod.contacts), rod.numbers()
    ends = [0, *(np.flatnonzero(np.diff(factors)) + 1).tolist(), places.size]
    for first, stop in itertools.pairwise(ends):
        numbers = whole._replace(mu=float(factors[first]) * whole.mu, drag=factors[first] * whole.drag)
        part = slice(first, stop)
        out = bend[part], drive[part], tension[part]
        rod_kernel.advance(state, places[part], numbers, step, 1, work, knots, *out)
    return bend
