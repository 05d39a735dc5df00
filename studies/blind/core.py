"""What a device core of the blind cases is, and how far a device may be off the one that was identified."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hystmpc.trials.types import Vec

TRAVEL_MM = 6.0
STROKE = 0.6
"""Share of the travel of the unlogged cycle before a trial, so that a trial does not open a virgin device."""


@dataclass(frozen=True)
class Mounting:
    """How far a device is from the one that its simulator was identified on.

    Attributes:
        gain, friction: factors.
        offset_deg: added to every angle [deg].
    """

    gain: float = 1.0
    friction: float = 1.0
    offset_deg: float = 0.0


class Core(ABC):
    """Hysteresis from displacement [mm] to angle [deg]."""

    @abstractmethod
    def run(self, x: Vec, scale: Vec) -> Vec:
        """Angles (T,) [deg] for the proximal end at x (T,) [mm] and friction factors (T,), on the fine grid.

        An unlogged cycle of `STROKE` goes before.
        """

    @abstractmethod
    def mounted(self, mounting: Mounting) -> Core:
        """The same device off its nominal numbers."""

    def numbers(self) -> dict[str, Any]:
        """Parameters, for the sealed answers."""
        return {"core": type(self).__name__, **asdict(self)}  # type: ignore[call-overload]


class QuasiStatic(Core):
    """A core whose angle depends on the path of the displacement alone, not on its speed."""

    gain: float
    offset_deg: float

    @abstractmethod
    def deflection(self, x: Vec, scale: Vec) -> Vec:
        """Distal displacement (T,) [mm] for proximal x (T,) [mm] and friction factors (T,)."""

    def run(self, x: Vec, scale: Vec) -> Vec:
        """offset + gain * deflection; see `Core.run`."""
        stroke = STROKE * TRAVEL_MM
        up, down = np.linspace(0.0, stroke, 400), np.linspace(stroke, float(x[0]), 400)
        before = np.concatenate([up, down])
        whole = np.concatenate([before, x])
        factors = np.concatenate([np.full(before.size, scale[0]), scale])
        return self.offset_deg + self.gain * self.deflection(whole, factors)[before.size :]
