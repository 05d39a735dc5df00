"""Stick-slip: friction that is larger at rest than in motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values
from .play import play


@final
@dataclass(frozen=True)
class StickSlip(Operator):
    """A play that is wide while it sticks and narrows with the speed at which it slides (threshold stick-slip).

    r_k = break_away exp(-v_{k-1} / stribeck_speed),  z_k = max(u_k - r_k, min(u_k + r_k, z_{k-1})),  y = z
    memory_s v' + v = |z'|  =>  v_k = s_k + exp(-dt / memory_s) (v_{k-1} - s_k),  s_k = |z_k - z_{k-1}| / dt

    A spring pulls a slider without mass whose friction falls with its speed, and remembers the speed for a while.
    Where break_away > stribeck_speed memory_s it breaks away with a jump d = break_away (1 - exp(-d / (stribeck_speed
    memory_s))), sticks again if the motion is slow and slides at a smaller width if it is fast. Without the memory the
    jump, and the speed above which it slides, would follow from the sample time. A jump takes some samples, however
    short they are. The part of friction that does not fall with speed is the play of the device itself. Break-away 0
    is the identity.

    Attributes:
        break_away: half-width at which it breaks away, beyond that of the device [in].
        stribeck_speed: speed at which 1/e of it is left [in/s].
        memory_s: time for which friction remembers the speed [s].

    Source: Stribeck curve and frictional memory as in Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30
    (1994), 1083-1138.
    """

    break_away: float
    stribeck_speed: float
    memory_s: float = 0.1
    name: ClassVar[str] = "stick_slip"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("break_away", "in", 0.0, 1e3, "half-width at which it breaks away"),
            Parameter("stribeck_speed", "in/s", 1e-3, 1e4, "speed at which 1/e of it is left"),
            Parameter("memory_s", "s", 1e-3, 1e2, "time for which friction remembers the speed"),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("z", "v")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        z = play(u, x[0], p[0] * ca.exp(-x[1] / p[1]))
        speed = ca.fabs(z - x[0]) / dt
        return ca.vertcat(z, speed + ca.exp(-dt / p[2]) * (x[1] - speed)), z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return ca.vertcat(play(u, y, p[0]), 0)
