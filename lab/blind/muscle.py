"""Pneumatic core of the blind cases, commanded in bar: the muscle of `sim/devices/muscle.py`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self, final

import numpy as np

from hystmpc.sim.devices.muscle import STATES, MuscleNumbers
from hystmpc.trials.types import Vec

from . import kernels
from .cores import FINE_S, QuasiStatic

_STRONGEST = 0.95  # friction over pull


@final
@dataclass(frozen=True)
class MuscleCore(QuasiStatic):
    """Muscle with slack, friction in proportion to its pull and a saturating angle; no lag or late share of its own.

    A friction factor s at work acts by the capstan's law: 1 - friction becomes (1 - friction)^s.

    Attributes:
        greatest_bar: greatest pressure [bar].
        greatest_deg: angle that no pressure exceeds [deg].
        friction: over pull, each way.
        presliding_bar: pressure over which friction turns its side [bar]; longer where the angle would rise as the
            pressure falls, see `kernels.muscle`.
        slack_bar: pressure at which the bladder meets the braid [bar].
        half_bar: pull that gives half of the greatest angle [bar].
        gain: factor of the angle.
        offset_deg: angle without pressure [deg].
    """

    UNIT = "bar"
    DRAWN: ClassVar = {
        "greatest_bar": (2.5, 3.5),
        "greatest_deg": (60.0, 100.0),
        "friction": (0.04, 0.10),
        "presliding_bar": (8.0, 12.0),  # over the friction
        "slack_bar": (0.1, 0.5),
        "half_bar": (0.8, 1.6),
    }
    FRICTION = ("friction",)
    greatest_bar: float = 3.0
    greatest_deg: float = 80.0
    friction: float = 0.07
    presliding_bar: float = 0.7
    slack_bar: float = 0.3
    half_bar: float = 1.2
    gain: float = 1.0
    offset_deg: float = 0.0

    @classmethod
    def draw(cls, random: np.random.Generator) -> Self:
        """A device of this kind whose own presliding is long enough at every pressure."""
        numbers = {name: float(random.uniform(*ends)) for name, ends in cls.DRAWN.items()}
        numbers["presliding_bar"] *= numbers["friction"]
        return cls(**numbers)

    @property
    def travel(self) -> float:
        """Greatest pressure [bar]."""
        return self.greatest_bar

    def stiffer(self, factor: float) -> Self:
        """More pull for the same angle."""
        return replace(self, half_bar=self.half_bar * factor)

    def reweighted(self, factor: float) -> Self:
        """Another presliding."""
        return replace(self, presliding_bar=self.presliding_bar * factor)

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        """Angle (T,) without offset [deg] for pressures x (T,) [bar] and friction factors (T,)."""
        out, state = np.empty(x.size), np.zeros(STATES)
        state[2] = -1.0  # the friction of a muscle that was vented
        friction = np.minimum(1 - (1 - self.friction) ** scale, _STRONGEST)
        kernels.muscle(x, friction, self.numbers_of_muscle(), FINE_S, state, out)
        return out

    def numbers_of_muscle(self) -> MuscleNumbers:
        """As the recursion reads them: valve and air are fast, as lag and creep stand before the core."""
        fast = {"supply_bar": 5.0, "valve_s": 0.002, "fill_s": 0.02, "vent_s": 0.02}
        return MuscleNumbers(
            **fast,
            slack_bar=self.slack_bar,
            slack_width_bar=0.08,
            friction=self.friction,
            presliding_bar=self.presliding_bar,
            greatest_deg=self.greatest_deg,
            half_bar=self.half_bar,
            late=0.0,
            late_share=1.0,
            bend_share=1.0,
        )
