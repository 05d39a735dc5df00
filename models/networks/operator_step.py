"""An operator inside a network: its step with parameters as signals, and the state from which it starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..model import Array
from ..operators.operator import Operator
from ..symbolic.instructions import dense


@dataclass(frozen=True)
class OperatorStep:
    """One sample of an operator of which only the last output is known at the start.

    Attributes:
        function: CasADi function (x (S,1), u, p (P,1)) -> (y, next x (S,1)).
        offset, slope: initial state x = offset + slope y (S,), y the output that is seen.
    """

    function: Any
    offset: Array
    slope: Array

    @property
    def size(self) -> int:
        """Entries S of the state."""
        return self.offset.size


def operator_step(operator: Operator, dt: float = 1.0) -> OperatorStep:
    """The step of an operator of this structure; `dt` [s] matters to those that know a rate.

    An operator whose state at rest follows from its output alone (a backlash) has just that state. One that has to
    see its first input (the inverse backlash, which compares inputs) gets two further entries, the output that was
    seen and whether a sample has been: its first sample finds it at rest at that input and that output.
    """
    size, count = len(operator.states), len(operator.parameters)
    x, u, y, p = ca.SX.sym("x", size), ca.SX.sym("u"), ca.SX.sym("y"), ca.SX.sym("p", count)
    rest = ca.densify(ca.SX(operator.at_rest(u, y, p)))
    if not ca.depends_on(rest, ca.vertcat(u, p)):
        following, output = operator.equation(x, u, p, dt)
        at = [np.asarray(ca.Function("rest", [y], [rest])(v)).ravel() for v in (0.0, 1.0)]
        return OperatorStep(dense("operator", [x, u, p], [output, following]), at[0], at[1] - at[0])
    seen = ca.SX.sym("seen")
    own = ca.vertcat(*(ca.if_else(seen > 0.5, x[i], rest[i]) for i in range(size)))
    following, output = operator.equation(own, u, p, dt)
    whole = ca.vertcat(x, y, seen)
    function = dense("operator", [whole, u, p], [output, ca.vertcat(following, y, 1.0)])
    return OperatorStep(function, np.zeros(size + 2), np.eye(size + 2)[size])
