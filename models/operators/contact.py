"""Contact: a stop, or stiffness that is added, beyond an angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .memoryless import Memoryless
from .operator import Parameter, Symbol, check_values, maximum

_SHARP = 1e-9  # a toe of zero is never divided by: no input lies strictly inside it


@final
@dataclass(frozen=True)
class Contact(Memoryless):
    """A slope that falls to a share of itself beyond an angle, at once or over a toe, as soft tissue stiffens.

    y = u - (1 - stiffness_ratio) d,  d = 0                      u <= angle
                                      d = (u - angle)^2 / (2 toe)   between, where its slope rises from 0 to 1
                                      d = u - angle - toe / 2    u >= angle + toe

    The ratio is that of the device's stiffness to the stiffness with what it touches: 0 is a rigid stop or saturation,
    1 is the identity.

    Attributes:
        angle: where contact begins [in].
        stiffness_ratio: slope beyond it, and beyond the toe [1].
        toe: over which the contact stiffens [in].
    """

    angle: float
    stiffness_ratio: float
    toe: float = 0.0
    name: ClassVar[str] = "contact"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("angle", "in", -1e4, 1e4, "where contact begins"),
            Parameter("stiffness_ratio", "1", 0.0, 1.0, "slope beyond it"),
            Parameter("toe", "in", 0.0, 1e4, "over which the contact stiffens"),
        )

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        deep, toe = u - p[0], p[2]
        soft = deep * deep / (2 * maximum(toe, _SHARP))
        return u - (1 - p[1]) * ca.if_else(deep >= toe, maximum(deep - toe / 2, 0), ca.if_else(deep > 0, soft, 0))
