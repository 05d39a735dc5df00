"""Device cores of the blind cases: distributed capstan friction, and parallel Dahl elements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from . import kernels
from .core import Mounting, QuasiStatic

_NODES = 16


@final
@dataclass(frozen=True)
class CapstanCore(QuasiStatic):
    """Tendon in a bent sheath, friction proportional to the local tension (capstan law), whose last part bends.

    The tendon also rubs along the part that bends, so that this part does not move as one piece.

    Attributes:
        gain: tip angle over distal displacement [deg/mm].
        offset_deg: angle at zero distal displacement [deg].
        wrap: friction coefficient times wrap angle.
        load: stiffness that the tendon pulls against [N/mm].
        compliance: of the whole tendon [mm/N].
        pretension: at rest [N].
        bending: share of the tendon's wrap that lies in the part that bends.
    """

    gain: float = 11.0
    offset_deg: float = 20.0
    wrap: float = 0.25
    load: float = 2.0
    compliance: float = 0.06
    pretension: float = 8.0
    bending: float = 0.5

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        out, tension = np.empty(x.size), np.full(_NODES, self.pretension)
        bends = np.arange(_NODES) >= round((1 - self.bending) * _NODES)
        weights = bends / bends.sum() / self.load
        shares = weights + self.compliance / _NODES
        kernels.capstan(x, self.wrap * scale, tension, shares, weights, self.pretension, out)
        return out

    def mounted(self, mounting: Mounting) -> CapstanCore:
        return replace(
            self,
            gain=self.gain * mounting.gain,
            wrap=self.wrap * mounting.friction,
            offset_deg=self.offset_deg + mounting.offset_deg,
        )

    @classmethod
    def draw(cls, random: np.random.Generator) -> CapstanCore:
        """A device of this kind."""
        return cls(
            gain=random.uniform(9, 13),
            offset_deg=random.uniform(10, 30),
            wrap=random.uniform(0.18, 0.34),
            load=random.uniform(1.5, 2.5),
            compliance=random.uniform(0.05, 0.08),
            pretension=random.uniform(7, 12),
            bending=random.uniform(0.35, 0.7),
        )


@final
@dataclass(frozen=True)
class DahlCore(QuasiStatic):
    """Displacement less the deflection of parallel Dahl elements (P. Dahl, Aerospace Corp. TOR-158, 1968).

    Attributes:
        gain: tip angle over distal displacement [deg/mm].
        offset_deg: angle at zero distal displacement [deg].
        friction: sum of the saturated deflections, half the width of the full loop [mm].
        spread: widest over narrowest element.
    """

    gain: float = 10.0
    offset_deg: float = 20.0
    friction: float = 0.25
    spread: float = 6.0

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        widths = np.geomspace(1.0, self.spread, 8) * 0.08
        shares = np.full(8, self.friction / float(widths.sum()))
        out, state = np.empty(x.size), np.zeros(8)
        kernels.dahl(x, scale, widths, shares, state, out)
        return x - out

    def mounted(self, mounting: Mounting) -> DahlCore:
        return replace(
            self,
            gain=self.gain * mounting.gain,
            friction=self.friction * mounting.friction,
            offset_deg=self.offset_deg + mounting.offset_deg,
        )

    @classmethod
    def draw(cls, random: np.random.Generator) -> DahlCore:
        """A device of this kind."""
        return cls(
            gain=random.uniform(9, 12),
            offset_deg=random.uniform(10, 30),
            friction=random.uniform(0.15, 0.35),
            spread=random.uniform(4, 9),
        )
