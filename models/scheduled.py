"""Parameters of an operator that depend on a measured input, such as a pressure, a load or a tendon tension.

    p_eff = p + f(z) c(p),   f(z) = below min(z - z_0, 0) + above max(z - z_0, 0),   z within lower ... upper

c(p) = p for friction, gain and times, so that p_eff = p (1 + f(z)); c = 1 for an offset. An affine dependence has one
slope, below = above; a bent one has two. Their bounds keep 1 + f within 1/20 ... 20 over the range of the input. Beyond
that range the nearest value of the range counts: no parameter leaves its bounds at any z.

The present value of the input is a state, which holds until the device measures another one. So a model with inputs is
a model like any other: for one command, from a state. Where the input is known over time, as in a log, it is given as a
second signal, and the state follows it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError, did_you_mean

from .operators.hysteresis import Backlash
from .operators.operator import Operator, Parameter, Symbol, is_number, maximum, minimum

_NAMES = {
    "friction": re.compile(r"alpha|beta|r\d*|k[1-9]\d*|viscous|a|delta"),
    "gain": re.compile(r"a\d+|s\d+_\d+|k0|gain|m_lo|m_up|alpha_[12]"),
    "offset": re.compile(r"b|offset|c_lo|c_up"),
    "time": re.compile(r"tau.*_s"),
}
_UNITS = {"gain": ("deg/cmd",), "offset": ("deg", "cmd"), "time": ("s",)}

GROUPS = tuple(_NAMES)
"""Groups of parameters that may depend on an input: friction (widths, forces), stiffness, offset, time constants."""

_MOST = 20.0  # greatest factor on a parameter, and one over the least
_FAR = 1e12
_ENDS = ("reference", "lower", "upper")


@dataclass(frozen=True)
class MeasuredInput:
    """Signal that the device measures and no controller decides.

    Attributes:
        reference: value at which the parameters are those of the file; also the one of a device that measures none.
        lower, upper: range of the identification.

    Raises:
        ModelError: if these are not finite or not in order.
    """

    name: str
    reference: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.upper - self.lower) and self.lower <= self.reference <= self.upper > self.lower):
            raise ModelError(
                f"input {self.name}: reference {self.reference:.6g} within {self.lower:.6g} to {self.upper:.6g}, "
                "expected lower <= reference <= upper with lower < upper"
            )


@dataclass(frozen=True)
class Dependence:
    """Dependence of one group of parameters on an input; bent where its slope differs below and above the reference."""

    input: MeasuredInput
    group: str
    bent: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its slopes: per unit of the input."""
        ways = ("below", "above") if self.bent else ("per",)
        return tuple(f"{self.group}_{way}_{self.input.name}" for way in ways)

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper bound of each slope."""
        if self.group == "offset":
            return ((-1e4, 1e4),) * len(self.names)
        least, most, given = 1 / _MOST - 1, _MOST - 1, self.input
        down, up = given.reference - given.lower, given.upper - given.reference
        below = (-most / down, -least / down) if down else (-_FAR, _FAR)
        above = (least / up, most / up) if up else (-_FAR, _FAR)
        if self.bent:
            return below, above
        return ((max(below[0], above[0]), min(below[1], above[1])),)

    def share(self, z: Symbol, slopes: Sequence[Symbol]) -> Symbol:
        """f(z)."""
        given = self.input
        away = minimum(maximum(z, given.lower), given.upper) - given.reference
        slope = ca.if_else(away < 0, slopes[0], slopes[1]) if self.bent else slopes[0]
        return slope * away


def members(operator: Operator, group: str) -> tuple[int, ...]:
    """Positions of the parameters of a group; empty where the operator has none."""
    parameters = operator.parameters
    fitting = [k for k, p in enumerate(parameters) if _NAMES[group].fullmatch(p.name)]
    if group == "friction" and isinstance(operator, Backlash):
        return 2, 3  # the distance of its lines
    return tuple(k for k in fitting if group not in _UNITS or parameters[k].unit in _UNITS[group])


@final
@dataclass(frozen=True)
class Scheduled(Operator):
    """Operator whose parameters depend on measured inputs; it has the name of the operator inside.

    Attributes:
        slopes: of all dependences in order.
        at_rest_inputs: value of each input in a state at rest.

    Raises:
        ModelError: if the operator has no parameter of a group, or a slope is out of its bounds.
    """

    name: ClassVar[str] = "scheduled"
    shape: ClassVar[tuple[str, ...]] = ("operator", "dependences")

    operator: Operator
    dependences: tuple[Dependence, ...]
    slopes: tuple[float, ...]
    at_rest_inputs: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.operator.name)
        super().__post_init__()

    @classmethod
    def of(cls, operator: Operator, dependences: Sequence[Dependence], slopes: Iterable[float] = ()) -> Self:
        """Operator with its inputs at their references; slopes are zero where left out."""
        given = tuple(slopes) or (0.0,) * sum(len(d.names) for d in dependences)
        return cls(operator, tuple(dependences), given, tuple(i.reference for i in _inputs(dependences)))

    def check_sizes(self) -> None:
        for d in self.dependences:
            if d.group not in GROUPS or not members(self.operator, d.group):
                groups = [group for group in GROUPS if members(self.operator, group)]
                raise ModelError(
                    f"{self.name}: no {d.group} that could depend on an input, {did_you_mean(d.group, groups)}"
                )
        if len({(d.input.name, d.group) for d in self.dependences}) < len(self.dependences):
            raise ModelError(f"{self.name}: one group depends twice on one input")

    @property
    def inner(self) -> Operator:
        return self.operator

    @property
    def inputs(self) -> tuple[MeasuredInput, ...]:
        """Measured inputs on which it depends, each once."""
        return _inputs(self.dependences)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        slopes = [
            Parameter(name, self._unit(d), *ends, f"change of {d.group} per unit of {d.input.name}")
            for d in self.dependences
            for name, ends in zip(d.names, d.bounds, strict=True)
        ]
        rests = [Parameter(f"{i.name}_at_rest", "1", -_FAR, _FAR, "value in a state at rest") for i in self.inputs]
        return (*self.operator.parameters, *slopes, *rests)

    def _unit(self, dependence: Dependence) -> str:
        if dependence.group != "offset":
            return "1"
        return self.operator.parameters[members(self.operator, "offset")[0]].unit

    @property
    def values(self) -> tuple[float, ...]:
        return (*self.operator.values, *self.slopes, *self.at_rest_inputs)

    def with_values(self, values: Sequence[float]) -> Self:
        n, m = len(self.operator.values), len(self.slopes)
        inner = self.operator.with_values(values[:n])
        return replace(self, operator=inner, slopes=tuple(values[n : n + m]), at_rest_inputs=tuple(values[n + m :]))

    @property
    def states(self) -> tuple[str, ...]:
        return (*self.operator.states, *(i.name for i in self.inputs))

    @property
    def structure(self) -> dict[str, Any]:
        inside = type(self.operator), tuple(self.operator.structure.items())
        return {"inside": inside, "dependences": self.dependences}

    @classmethod
    def template(cls, **structure: Any) -> Self:
        kind, sizes = structure["inside"]
        return cls.of(kind.template(**dict(sizes)), structure["dependences"])

    def resampled(self, dt_s: float, was_s: float) -> Operator:
        return replace(self, operator=self.operator.resampled(dt_s, was_s))

    @property
    def settling_samples(self) -> int:
        return self.operator.settling_samples

    @property
    def rest_samples(self) -> int:
        return self.operator.rest_samples

    def effective(self, p: Symbol, z: Symbol) -> Symbol:
        """Parameters (P, 1) of the operator inside at the inputs z (Z, 1)."""
        inner = self.operator.parameters
        n, at = len(inner), {i.name: k for k, i in enumerate(self.inputs)}
        changed, rest = [p[k] for k in range(n)], n
        for d in self.dependences:
            share = d.share(z[at[d.input.name]], [p[rest + k] for k in range(len(d.names))])
            rest += len(d.names)
            for k, by in self._changes(d.group, p):
                changed[k] = changed[k] + share * by
                if d.group == "time":
                    changed[k] = minimum(maximum(changed[k], inner[k].lower), inner[k].upper)
        return ca.vertcat(*changed)

    def _changes(self, group: str, p: Symbol) -> list[tuple[int, Symbol]]:
        """c(p) of the parameters that change, by position."""
        places = members(self.operator, group)
        if group == "friction" and isinstance(self.operator, Backlash):
            half = (p[2] - p[3]) / 2
            return [(2, half), (3, -half)]
        return [(k, 1 if group == "offset" else p[k]) for k in places]

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = len(self.operator.states)
        z = x[n:] if u.numel() == 1 else u[1:]
        following, y = self.operator.equation(x[:n], u[0], self.effective(p, z), dt)
        return ca.vertcat(following, z), y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        z = p[p.numel() - len(self.inputs) :]
        return ca.vertcat(self.operator.at_rest(u, y, self.effective(p, z)), z)


def _inputs(dependences: Iterable[Dependence]) -> tuple[MeasuredInput, ...]:
    return tuple(dict.fromkeys(d.input for d in dependences))


def inputs_of(operators: Iterable[Operator]) -> tuple[MeasuredInput, ...]:
    """Inputs of operators, each once, in the order of the signal.

    Raises:
        ModelError: if two operators have another range or reference of one input.
    """
    known: dict[str, MeasuredInput] = {}
    for given in (i for o in operators if isinstance(o, Scheduled) for i in o.inputs):
        if known.setdefault(given.name, given) != given:
            raise ModelError(f"input {given.name}: got two ranges or references in one chain, expected one")
    return tuple(known.values())


def input_states(operators: Iterable[Operator]) -> Mapping[str, tuple[int, ...]]:
    """Entries of the chain's state that hold each input."""
    places: dict[str, list[int]] = {}
    at = 0
    for operator in operators:
        if isinstance(operator, Scheduled):
            first = at + len(operator.operator.states)
            for k, given in enumerate(operator.inputs, first):
                places.setdefault(given.name, []).append(k)
        at += len(operator.states)
    return {name: tuple(entries) for name, entries in places.items()}


def dependence_spec(operator: Scheduled) -> dict[str, Any]:
    """Plain data from which `scheduled_from` adds the dependences again, by input."""
    spec: dict[str, dict[str, Any]] = {
        i.name: {"reference": i.reference, "lower": i.lower, "upper": i.upper} for i in operator.inputs
    }
    rest = list(operator.slopes)
    for d in operator.dependences:
        slopes, rest = rest[: len(d.names)], rest[len(d.names) :]
        spec[d.input.name][d.group] = slopes if d.bent else slopes[0]
    return spec


def scheduled_from(operator: Operator, spec: Any, where: str) -> Scheduled:
    """Operator with the dependences of a block `depends_on`.

    Raises:
        ModelError: on an unknown group, a missing number, or one out of bounds; one line.
    """
    if not isinstance(spec, Mapping) or not spec:
        raise ModelError(f"{where}.depends_on: got {spec!r:.40}, expected a block for each input")
    made: list[Dependence] = []
    slopes: list[float] = []
    for name, block in spec.items():
        groups = [key for key in block if key not in _ENDS] if isinstance(block, Mapping) else []
        if not groups or not all(is_number(block.get(key)) for key in _ENDS):
            raise ModelError(
                f"{where}.depends_on.{name}: expected numbers {', '.join(_ENDS)} and one of {', '.join(GROUPS)}"
            )
        given = MeasuredInput(str(name), *(float(block[key]) for key in _ENDS))
        for group in groups:
            numbers = block[group] if isinstance(block[group], list) else [block[group]]
            if len(numbers) > 2 or not numbers or not all(map(is_number, numbers)):
                raise ModelError(f"{where}.depends_on.{name}.{group}: expected a slope, or two: below, above")
            made.append(Dependence(given, str(group), len(numbers) == 2))
            slopes += map(float, numbers)
    try:
        return Scheduled.of(operator, made, slopes)
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from None
