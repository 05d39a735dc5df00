"""A chain of operators: command side, hysteresis core, output side, as one symbolic step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError

from .kernels.program import dense
from .operators.operator import Operator, Parameter


@dataclass(frozen=True)
class Chain:
    """Operators in the order in which the signal passes them.

    Attributes:
        before: operators on the command [cmd].
        core: the operator that turns the command into an angle.
        after: operators on the angle [deg].
    """

    core: Operator
    before: tuple[Operator, ...] = ()
    after: tuple[Operator, ...] = ()

    @property
    def operators(self) -> tuple[Operator, ...]:
        """All operators in the order of the signal."""
        return (*self.before, self.core, *self.after)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of `values`."""
        return tuple(parameter for operator in self.operators for parameter in operator.parameters)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names `operator.parameter`, in the order of `values`."""
        return tuple(f"{o.name}.{p.name}" for o in self.operators for p in o.parameters)

    @property
    def values(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Parameter values (P,)."""
        return np.array([v for operator in self.operators for v in operator.values])

    def with_values(self, values: Sequence[float]) -> Chain:
        """The same chain with other parameter values.

        Raises:
            ModelError: if there are too few or too many, or one is out of bounds.
        """
        if len(values) != len(self.parameters):
            raise ModelError(f"got {len(values)} parameter values, expected {len(self.parameters)}")
        rest, operators = list(values), []
        for operator in self.operators:
            taken, rest = rest[: len(operator.parameters)], rest[len(operator.parameters) :]
            operators.append(operator.with_values(taken))
        first, last = len(self.before), len(self.before) + 1
        return replace(self, before=tuple(operators[:first]), core=operators[first], after=tuple(operators[last:]))

    def at_sample_time(self, dt_s: float, was_s: float) -> Chain:
        """The same chain run at sample time `dt_s`, from `was_s` [s]: stores of delays and starts of clocks fit it."""
        before, after = (tuple(o.resampled(dt_s, was_s) for o in own) for own in (self.before, self.after))
        return replace(self, before=before, after=after)

    @property
    def state_size(self) -> int:
        """Number of state entries."""
        return sum(len(operator.states) for operator in self.operators)

    @property
    def settling_samples(self) -> int:
        """Samples of constant command that make the guess of the initial state irrelevant."""
        return max(operator.settling_samples for operator in self.operators)

    @property
    def rest_samples(self) -> int:
        """Samples for which the command is held from the state at rest on; see `Operator.rest_samples`."""
        return max(operator.rest_samples for operator in self.operators)

    @cached_property
    def transition(self) -> Any:
        """CasADi function (state (S,1), u, p (P,1), dt) -> (theta, next state (S,1))."""
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        p, dt = ca.SX.sym("p", len(self.parameters)), ca.SX.sym("dt")
        signal, following = u, []
        for operator, state, values in self._parts(x, p):
            state_next, signal = operator.equation(state, signal, values, dt)
            following.append(state_next)
        return dense("transition", [x, u, p, dt], [signal, ca.vertcat(*following)])

    @cached_property
    def rest(self) -> Any:
        """CasADi function (y, u, p) -> state (S,1) of a device that rests at command `u` and shows angle `y`."""
        y, u, p = ca.SX.sym("y"), ca.SX.sym("u"), ca.SX.sym("p", len(self.parameters))
        states = []
        for k, (operator, _, values) in enumerate(self._parts(ca.SX.sym("x", self.state_size), p)):
            # Up to the core the signal at rest is the command itself, from the core on the angle that was seen.
            seen_in, seen_out = (u if k <= len(self.before) else y), (u if k < len(self.before) else y)
            states.append(operator.at_rest(seen_in, seen_out, values))
        return dense("rest", [y, u, p], [ca.vertcat(*states)])

    def bound(self, dt: float) -> Any:
        """CasADi function (state, u) -> (theta, next state) with this chain's numbers and `dt` [s] inside."""
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        theta, following = self.transition(x, u, ca.DM(self.values), dt)
        return dense("step", [x, u], [theta, following])

    def _parts(self, x: Any, p: Any) -> list[tuple[Operator, Any, Any]]:
        """Each operator with its own slice of state and parameters."""
        parts, i, j = [], 0, 0
        for operator in self.operators:
            n, m = len(operator.states), len(operator.parameters)
            parts.append((operator, x[i : i + n], p[j : j + m]))
            i, j = i + n, j + m
        return parts
