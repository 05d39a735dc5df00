"""Trial shift: what changes from trial to trial and stays within one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

from .operator import Operator, Parameter, Symbol, check_values
from .play import play


@final
@dataclass(frozen=True)
class TrialShift(Operator):
    """Offset, gain and extra play of one trial: re-mounting, a bend of the sheath, another pretension.

    v = gain u + offset,  z_k = max(v_k - width, min(v_k + width, z_{k-1})),  y = z

    Offset 0, gain 1 and width 0 are the identity.

    Attributes:
        offset: [in].
        gain: [1].
        width: half-width of the extra play [in].
    """

    offset: float
    gain: float
    width: float
    name: ClassVar[str] = "trial_shift"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 1.0, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("offset", "in", -1e4, 1e4, "offset of this trial"),
            Parameter("gain", "1", 0.05, 20.0, "gain of this trial"),
            Parameter("width", "in", 0.0, 1e3, "half-width of the extra play of this trial"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(p[1] * u + p[0], x[0], p[2])
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(p[1] * u + p[0], y, p[2])
