"""Operators: one equation each on CasADi symbols, with parameters that carry unit and bounds."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Self, get_origin, get_type_hints

import casadi as ca

from hystmpc.trials.errors import ModelError

Symbol = Any  # casadi.SX, which has no types


@dataclass(frozen=True)
class Parameter:
    """Name, unit, bounds and meaning of an operator's parameter.

    Attributes:
        name: name in a simulator file.
        unit: with `cmd` for the unit of the command (mm or bar), and `in` for the unit of the signal that passes: `cmd`
            on the command side, `deg` on the output side.
        lower, upper: bounds, inclusive; identification stays within them. Those of a quantity with `cmd`, `deg` or `in`
            in its unit are meant for a device whose command's range is 1 to 10 and whose output's is 10 to 100, to
            which `models.decades` brings any other; of a device in log units only their signs count.
    """

    name: str
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True)
class Number:
    """Declaration of a parameter in a field of an operator: `Annotated[float, Number(...)]`.

    Attributes:
        template: value in `Operator.template`.
    """

    unit: str
    lower: float
    upper: float
    template: float
    meaning: str


class Operator(ABC):
    """Block of a simulator: a causal map of a scalar signal with explicit state.

    A subclass is a frozen dataclass with one field for each parameter, and its equation is a CasADi expression. NumPy,
    compiled, torch, CasADi and ONNX forms, Jacobians included, are derived from it (`models/program.py`). An operator
    of variable size defines its parameters, states and template.

    Raises:
        ModelError: if a parameter is out of its bounds.
    """

    name: ClassVar[str]
    state_names: ClassVar[tuple[str, ...]] = ()
    shape: ClassVar[tuple[str, ...]] = ()  # attributes that fix the size of state or parameters
    default_sizes: ClassVar[Mapping[str, int]] = {}  # sizes that a specification may leave out
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {}  # limits other than 1 to 1000

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name})"

    def __post_init__(self) -> None:
        for name in self._value_fields():
            if isinstance(value := getattr(self, name), Iterable):
                object.__setattr__(self, name, tuple(float(v) for v in value))
        self.check_sizes()
        check_values(self)

    def check_sizes(self) -> None:  # noqa: B027 - most operators have one size
        """Check that sizes and the lengths of tuple parameters fit each other.

        Raises:
            ModelError: if they do not.
        """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters in the order of `values`."""
        return tuple(Parameter(n, p.unit, p.lower, p.upper, p.meaning) for n, p in _numbers(type(self)).items())

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the state's entries."""
        return self.state_names

    @abstractmethod
    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        """Next state (S, 1) and output from state, input, parameters (P, 1) and sample time [s]."""

    @abstractmethod
    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """State (S, 1) of an operator at rest at input `u` and output `y`."""

    @classmethod
    def template(cls, **structure: int) -> Self:
        """Operator of the given structure, to be filled by `with_values`."""
        sizes = {name: structure[name] for name in cls.shape if name in structure}
        return cls(**{name: number.template for name, number in _numbers(cls).items()}, **sizes)

    @property
    def structure(self) -> dict[str, int]:
        """Sizes named in `shape`, which are fixed in a fit."""
        return {name: getattr(self, name) for name in self.shape}

    @property
    def values(self) -> tuple[float, ...]:
        """Parameter values: the fields in order, tuples unrolled."""
        flat: list[float] = []
        for field in self._value_fields():
            value = getattr(self, field)
            flat.extend(value if isinstance(value, tuple) else (value,))
        return tuple(float(v) for v in flat)

    def with_values(self, values: Sequence[float]) -> Self:
        """Operator with other parameter values, in the order of `values`."""
        rest = [float(v) for v in values]
        changes: dict[str, Any] = {}
        for field in self._value_fields():
            old = getattr(self, field)
            count = len(old) if isinstance(old, tuple) else 1
            taken, rest = rest[:count], rest[count:]
            changes[field] = tuple(taken) if isinstance(old, tuple) else taken[0]
        return replace(self, **changes)  # type: ignore[type-var]  # every final operator is a dataclass

    def _value_fields(self) -> list[str]:
        return [f.name for f in fields(self) if f.name not in self.shape]  # type: ignore[arg-type]  # as above

    @property
    def inner(self) -> Operator:
        """The operator without dependences on measured inputs, see `models.scheduled`: itself where it has none."""
        return self

    def resampled(self, dt_s: float, was_s: float) -> Operator:
        """Operator converted from sample time `was_s` to `dt_s` [s]: stores of delays and phases of clocks change."""
        del dt_s, was_s
        return self

    @property
    def settling_samples(self) -> int:
        """Number of samples of constant input after which the guess of `at_rest` has no influence."""
        return 1

    @property
    def rest_samples(self) -> int:
        """Number of samples of constant input until rest; 0 where `at_rest` is exact for possible outputs."""
        return 0


@cache
def _numbers(kind: type[Operator]) -> dict[str, Number]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if get_origin(hint) is Annotated}


def check_values(operator: Operator) -> None:
    """Check values against their bounds; where the unit is that of a signal only against their signs.

    Raises:
        ModelError: naming the parameter, the value and the bounds.
    """
    for parameter, value in zip(operator.parameters, operator.values, strict=True):
        low, high = parameter.lower, parameter.upper
        if _has_a_size(parameter.unit):
            low, high = (0.0 if low == 0 else _LEAST if low > 0 else -_GREATEST), _GREATEST
        if not (math.isfinite(value) and low <= value <= high):
            raise ModelError(
                f"{operator.name}.{parameter.name} is {value:.6g} {parameter.unit}, expected {low:.6g} to {high:.6g}"
            )


def is_number(value: Any) -> bool:
    """Whether plain data is a number; True and False are not numbers."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _has_a_size(unit: str) -> bool:
    """Whether a parameter of this unit changes its value with the unit of a signal; one in deg/deg does not."""
    above, _, below = unit.partition("/")
    return above != below and _OF_A_SIGNAL.search(unit) is not None


_OF_A_SIGNAL = re.compile(r"\b(cmd|deg|in)\b")
_LEAST, _GREATEST = 1e-15, 1e15  # a million times smaller or larger than a catheter in mm and deg, both signals


# CasADi's fmin and fmax average the two derivatives at a tie; a play in contact sits exactly on a tie, and its
# derivative has to be that of the branch that moves. The first argument is the active one at a tie.
def minimum(a: Symbol, b: Symbol) -> Symbol:
    """Return min(a, b) with the derivative of the active branch, the first at a tie."""
    return ca.if_else(a <= b, a, b)


def maximum(a: Symbol, b: Symbol) -> Symbol:
    """Return max(a, b) with the derivative of the active branch, the first at a tie."""
    return ca.if_else(a >= b, a, b)


def play(u: Symbol, z: Symbol, r: Symbol) -> Symbol:
    """Next state of a play with half-width `r` and state `z`: max(u - r, min(u + r, z))."""
    return maximum(u - r, minimum(u + r, z))


class Memoryless(Operator):
    """Static map y = curve(u), whose state is the last output, since every step needs a state."""

    state_names: ClassVar[tuple[str, ...]] = ("y",)

    @abstractmethod
    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        """Output from input and parameters (P, 1)."""

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del x, dt
        y = self.curve(u, p)
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u)


@cache
def shipped_operators() -> Mapping[str, type[Operator]]:
    """Operators by name: the concrete subclasses of `Operator` in the modules of this package."""
    package, folder = __name__.rpartition(".")[0], str(Path(__file__).parent)
    modules = [importlib.import_module(f"{package}.{module.name}") for module in pkgutil.iter_modules([folder])]
    module = [kind for module in modules for kind in vars(module).values() if inspect.isclass(kind)]
    kinds = [kind for kind in module if issubclass(kind, Operator) and not inspect.isabstract(kind)]
    return MappingProxyType({kind.name: kind for kind in kinds})


STRIBECK = (
    Parameter("stribeck", "1", 0.0, 10.0, "share by which friction at rest exceeds that of a fast motion"),
    Parameter("stribeck_speed", "cmd/s", 1e-3, 1e4, "speed at which 1/e of that is left"),
)
"""Parameters of friction that is greater at rest, see `stribeck_factor`."""

PLAY_FRICTION = (
    *STRIBECK,
    Parameter("one_way", "1", -0.9, 10.0, "share by which friction is greater while the command falls"),
)
"""Parameters of a friction of plays that depends on speed and direction, see `play_friction`."""


def stribeck_factor(speed: Symbol, stribeck: Symbol, stribeck_speed: Symbol) -> Symbol:
    """Factor of the widths of all plays at a speed: 1 + stribeck exp(-speed / stribeck_speed)."""
    return 1 + stribeck * ca.exp(-speed / stribeck_speed)


def play_friction(move: Symbol, falling: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
    """Factor of the widths of all plays after a move of the command, and whether that was last falling (1, else 0).

        (1 + stribeck exp(-|move / dt| / stribeck_speed)) (1 + one_way falling)

    Args:
        falling: the same before the move.
        p: `stribeck`, `stribeck_speed`, `one_way`.
    """
    falling = ca.if_else(move < 0, 1, ca.if_else(move > 0, 0, falling))
    return stribeck_factor(ca.fabs(move) / dt, p[0], p[1]) * (1 + p[2] * falling), falling


def check_speeds(name: str, speeds: Sequence[float], count: int = len(STRIBECK)) -> None:
    """Check that there are so many values of a friction that depends on the speed, or none.

    Raises:
        ModelError: on another number of them.
    """
    if len(speeds) not in (0, count):
        raise ModelError(f"{name}: {len(speeds)} numbers of the speed, expected none or {count}")
