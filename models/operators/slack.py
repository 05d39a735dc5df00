"""Slack: a tendon that hangs, or a muscle below its threshold pressure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from .memoryless import Memoryless
from .operator import Parameter, Symbol, check_values, maximum, minimum

_SHARP = 1e-9  # a toe of zero is never divided by: no command lies strictly inside it


@final
@dataclass(frozen=True)
class Slack(Memoryless):
    """A dead zone at low command, with a toe where one fibre or tendon after another is taken up.

    y = 0                          u <= slack - toe
    y = (u - slack + toe)^2 / (4 toe)   between, where the slope rises from 0 to 1
    y = u - slack                  u >= slack + toe

    and y = u where that is less, so that commands below zero, which devices do not take, pass. Slack 0 and toe 0 are
    the identity; a sharp corner has no toe.

    Attributes:
        slack: command that is taken up in all [cmd].
        toe: half the travel over which it is taken up [cmd].
    """

    slack: float
    toe: float = 0.0
    name: ClassVar[str] = "slack"

    def __post_init__(self) -> None:
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        del structure
        return cls(0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("slack", "in", 0.0, 1e3, "command that is taken up before all of it arrives"),
            Parameter("toe", "in", 0.0, 1e3, "half the travel over which it is taken up"),
        )

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        over, toe = u - p[0], p[1]
        curved = (over + toe) * (over + toe) / (4 * maximum(toe, _SHARP))
        # Where branches tie the one that moves when the command rises is active.
        loaded = ca.if_else(over >= toe, over, ca.if_else(over > -toe, curved, 0))
        return minimum(loaded, u)
