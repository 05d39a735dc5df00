"""Chains of operators (command side, hysteresis core, output side) as one symbolic step and as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError, did_you_mean

from .effects.catalogue import added_operators
from .operators.dynamics import Delay, Lag, LinearDynamics, RateLimit, Servo
from .operators.operator import Operator, Parameter, is_number, shipped_operators
from .program import dense
from .scheduled import (
    Dependence,
    MeasuredInput,
    Scheduled,
    dependence_spec,
    input_states,
    inputs_of,
    members,
    scheduled_from,
)

DYNAMICS = (Delay, Lag, Servo, LinearDynamics, RateLimit)
"""Operators that are not inverted sample by sample: that would amplify every deviation."""


@dataclass(frozen=True)
class Chain:
    """Operators in series: before the core, the hysteresis core, and behind it.

    Attributes:
        before: operators on the command [cmd].
        core: operator from the command to an angle.
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
        """Chain with other parameter values.

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
        """Chain at sample time `dt_s` instead of `was_s` [s]; stores of delays and initial clock phases are adapted."""
        before, after = (tuple(o.resampled(dt_s, was_s) for o in side) for side in (self.before, self.after))
        return replace(self, before=before, after=after)

    def with_room(self, dt_s: float) -> Chain:
        """Chain whose delays have stores that are long enough for sample time `dt_s` [s]."""
        sides = [
            tuple(o.resampled(dt_s, dt_s) if isinstance(o, Delay) and not o.holds(dt_s) else o for o in side)
            for side in (self.before, self.after)
        ]
        return self if sides == [self.before, self.after] else replace(self, before=sides[0], after=sides[1])

    @property
    def state_size(self) -> int:
        """Number of entries of the state."""
        return sum(len(operator.states) for operator in self.operators)

    @property
    def settling_samples(self) -> int:
        """Number of samples of constant command after which the guessed initial state has no influence."""
        return max(operator.settling_samples for operator in self.operators)

    @property
    def rest_samples(self) -> int:
        """Number of samples for which the command is held after the state at rest; see `Operator.rest_samples`."""
        return max(operator.rest_samples for operator in self.operators)

    @property
    def inputs(self) -> tuple[MeasuredInput, ...]:
        """Measured inputs on which parameters depend, each once."""
        return inputs_of(self.operators)

    @property
    def input_states(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of the state that hold the present value of each input."""
        return input_states(self.operators)

    def at_inputs(self, values: Mapping[str, float]) -> Chain:
        """Chain whose states at rest are those at these values of its inputs; the others keep theirs."""

        def at(operator: Operator) -> Operator:
            if not isinstance(operator, Scheduled):
                return operator
            pairs = zip(operator.inputs, operator.at_rest_inputs, strict=True)
            return replace(operator, at_rest_inputs=tuple(values.get(i.name, value) for i, value in pairs))

        before, after = (tuple(map(at, side)) for side in (self.before, self.after))
        return replace(self, before=before, core=at(self.core), after=after) if values else self

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
        """CasADi function (y, u, p) -> state (S,1) of a device at rest at command `u` with output angle `y`."""
        y, u, p = ca.SX.sym("y"), ca.SX.sym("u"), ca.SX.sym("p", len(self.parameters))
        states = []
        for k, (operator, _, values) in enumerate(self._parts(ca.SX.sym("x", self.state_size), p)):
            # Up to the core the signal at rest is the command itself, from the core on the angle that was seen.
            seen_in, seen_out = (u if k <= len(self.before) else y), (u if k < len(self.before) else y)
            states.append(operator.at_rest(seen_in, seen_out, values))
        return dense("rest", [y, u, p], [ca.vertcat(*states)])

    def bound(self, dt: float) -> Any:
        """CasADi function (state, u) -> (theta, next state) with the values of this chain and `dt` [s] inserted."""
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        theta, following = self.transition(x, u, ca.DM(self.values), dt)
        return dense("step", [x, u], [theta, following])

    def _parts(self, x: Any, p: Any) -> list[tuple[Operator, Any, Any]]:
        parts, i, j = [], 0, 0
        for operator in self.operators:
            n, m = len(operator.states), len(operator.parameters)
            parts.append((operator, x[i : i + n], p[j : j + m]))
            i, j = i + n, j + m
        return parts


_SIZES = (1, 1000)
_GUESSED = range(1, 9)


def operators() -> Mapping[str, type[Operator]]:
    """All operators by name: those of the package and those of effects added by users."""
    return {**added_operators(), **shipped_operators()}


def operator_from(spec: Any, where: str) -> Operator:
    """Build an operator from `{operator: NAME, <sizes>, parameters: {NAME: value}}`.

    Raises:
        ModelError: on an unknown operator or key, a missing size, a missing, unknown or out-of-bounds parameter.
    """
    if not isinstance(spec, dict) or "operator" not in spec:
        raise ModelError(f"{where}: got {spec!r}, expected a mapping with the key 'operator'")
    name = str(spec["operator"])
    kind = shipped_operators().get(name) or operators().get(name)
    if kind is None:
        raise ModelError(f"{where}: no operator {name!r}, {did_you_mean(name, operators())}")
    for key in spec:
        if key not in (known := ("operator", "parameters", "depends_on", *kind.shape)):
            raise ModelError(f"{where}: unknown key {key!r}, {did_you_mean(key, known[1:])}")
    given = spec.get("parameters")
    if not isinstance(given, dict) or not all(is_number(v) for v in given.values()):
        raise ModelError(f"{where}: {name}.parameters is {given!r}, expected a mapping of numbers")
    template = template_from(kind, spec, given, where)
    try:
        operator = template.with_values(_ordered(name, [p.name for p in template.parameters], given))
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from None
    return scheduled_from(operator, spec["depends_on"], where) if "depends_on" in spec else operator


def _ordered(operator_name: str, names: Sequence[str], given: dict[str, float]) -> list[float]:
    """Named values in the order of `names`; raises an error on a missing or unknown name."""
    for name in given:
        if name not in names:
            raise ModelError(f"{operator_name} has no parameter {name!r}, {did_you_mean(name, names)}")
    missing = [name for name in names if name not in given]
    if missing:
        raise ModelError(f"{operator_name} lacks {', '.join(missing)}, got {', '.join(given) or 'none'}")
    return [float(given[name]) for name in names]


def operator_spec(operator: Operator) -> dict[str, Any]:
    """Plain data from which `operator_from` builds the operator again."""
    if isinstance(operator, Scheduled):
        return {**operator_spec(operator.operator), "depends_on": dependence_spec(operator)}
    names = (parameter.name for parameter in operator.parameters)
    return {
        "operator": operator.name,
        **{key: size for key, size in operator.structure.items() if size != operator.default_sizes.get(key)},
        "parameters": dict(zip(names, operator.values, strict=True)),
    }


def template_from(kind: type[Operator], spec: Mapping[str, Any], given: Iterable[str], where: str) -> Operator:
    """Operator of the sizes in `spec`, to be filled with parameter values.

    A missing size follows from the parameters' names, as `tau_up_s` implies two time constants, or is the default.

    Raises:
        ModelError: on a size that is missing or no whole number within its limits.
    """
    sizes = {key: spec.get(key, kind.default_sizes.get(key)) for key in kind.shape}
    for key, size in sizes.items():
        _check_size(size, kind.size_limits.get(key, _SIZES), f"{where}: {kind.name}.{key}")
    template, wanted = kind.template(**sizes), set(given)
    for key in kind.default_sizes:
        if key in spec or wanted <= names_of(template):
            continue
        lower, upper = kind.size_limits.get(key, _SIZES)
        guesses = (kind.template(**{**sizes, key: n}) for n in _GUESSED if lower <= n <= upper)
        template = next((guess for guess in guesses if wanted <= names_of(guess)), template)
    return template


def names_of(operator: Operator) -> set[str]:
    """Parameter names of the operator."""
    return {parameter.name for parameter in operator.parameters}


def _check_size(value: Any, limits: tuple[int, int], where: str) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not limits[0] <= value <= limits[1]:
        raise ModelError(f"{where} is {value!r}, expected a whole number from {limits[0]} to {limits[1]}")


def chain_spec(chain: Chain) -> dict[Literal["before", "core", "after"], Any]:
    """Plain data from which `chain_from` builds the chain again."""
    return {
        "before": [operator_spec(operator) for operator in chain.before],
        "core": operator_spec(chain.core),
        "after": [operator_spec(operator) for operator in chain.after],
    }


def chain_from(spec: Mapping[Literal["before", "core", "after"], Any], where: str) -> Chain:
    """Chain built from plain data.

    Raises:
        ModelError: if it has no core, or names an unknown operator.
    """
    if "core" not in spec:
        raise ModelError(f"{where} has no 'core', got {', '.join(spec) or 'nothing'}")
    return Chain(
        operator_from(spec["core"], f"{where}.core"),
        _side(spec.get("before"), f"{where}.before"),
        _side(spec.get("after"), f"{where}.after"),
    )


def _side(specs: Any, where: str) -> tuple[Any, ...]:
    if specs is not None and not isinstance(specs, list):
        raise ModelError(f"{where}: got {type(specs).__name__}, expected a list of operators")
    return tuple(operator_from(spec, f"{where}[{k}]") for k, spec in enumerate(specs or []))


def with_dependences(chain: Chain, dependences: Sequence[Dependence]) -> Chain:
    """Chain with slopes of zero: of its core, and of the time constants of drives on the command.

    A dependence on a group that no operator has is left out.
    """

    def of(operator: Operator, of_drive: bool) -> Operator:
        fitting = [d for d in dependences if (d.group == "time") == of_drive and members(operator, d.group)]
        return Scheduled.of(operator, fitting) if fitting else operator

    if not dependences:
        return chain
    before = tuple(of(o, True) if isinstance(o, Lag | Servo) else o for o in chain.before)
    return replace(chain, before=before, core=of(chain.core, False))


class Split(NamedTuple):
    """Chain in three parts: dynamics on the command, the invertible part, dynamics on the angle."""

    front: tuple[Operator, ...]
    middle: Chain
    back: tuple[Operator, ...]


def split(chain: Chain) -> Split:
    """Split a chain into dynamics on the command, the invertible part, and dynamics on the angle."""
    last = max((k + 1 for k, o in enumerate(chain.before) if isinstance(o.inner, DYNAMICS)), default=0)
    first = min((k for k, o in enumerate(chain.after) if isinstance(o.inner, DYNAMICS)), default=len(chain.after))
    middle = Chain(chain.core, chain.before[last:], chain.after[:first])
    return Split(chain.before[:last], middle, chain.after[first:])
