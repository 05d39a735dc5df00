"""Slack: a tendon that hangs, or a muscle below its threshold pressure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .operator import Operator, Parameter, Symbol, check_values, maximum, minimum


@final
@dataclass(frozen=True)
class Slack(Operator):
    """A dead zone at low command.

    y = max(u - slack, 0) for u >= 0,  y = u for u < 0

    Slack 0 is the identity; commands below zero, which devices do not take, pass so that it is one everywhere.

    Attributes:
        slack: command that is taken up before anything moves [cmd].
    """

    slack: float
    name: ClassVar[str] = "slack"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("slack", "in", 0.0, 1e3, "command that is taken up before anything moves"),)

    @property
    def states(self) -> tuple[str, ...]:
        return ("y",)  # of no effect: every step of the contract has a state

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del x, dt
        # Where the branches tie, u = 0 or u = slack, the one that moves when the command rises is active.
        y = minimum(maximum(u - p[0], 0), u)
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u)
