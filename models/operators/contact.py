"""Contact: a stop, or stiffness that is added, beyond an angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .memoryless import Memoryless
from .operator import Parameter, Symbol, check_values, maximum


@final
@dataclass(frozen=True)
class Contact(Memoryless):
    """A slope that falls to a share of itself beyond an angle.

    y = u - (1 - stiffness_ratio) max(u - angle, 0)

    The ratio is that of the device's stiffness to the stiffness with what it touches: 0 is a rigid stop or saturation,
    1 is the identity.

    Attributes:
        angle: where contact begins [in].
        stiffness_ratio: slope beyond it [1].
    """

    angle: float
    stiffness_ratio: float
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
        )

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        return u - (1 - p[1]) * maximum(u - p[0], 0)
