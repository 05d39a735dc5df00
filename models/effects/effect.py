"""What an effect is: an operator with the sides it may act on, its neutral values and where a search for it starts."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hystmpc.trials.errors import ModelError

from ..operators.operator import Operator, Parameter

Side = Literal["command", "output"]
_NUMBER = re.compile(r"_\d+(?=_|$)")
_WAY = re.compile(r"_(up|down)(?=_|$)")


@dataclass(frozen=True)
class Scale:
    """Sizes of a device and its motions, in which searches are the same for all.

    Attributes:
        command: lowest and highest command [cmd].
        angle_deg: lowest and highest angle [deg].
        duration_s: length of a trial [s].
        dt_s: sample time [s].

    Raises:
        ModelError: if a range is empty or a time not above zero.
    """

    command: tuple[float, float]
    angle_deg: tuple[float, float]
    duration_s: float
    dt_s: float

    def __post_init__(self) -> None:
        spans = self.command[1] - self.command[0], self.angle_deg[1] - self.angle_deg[0]
        if not (min(*spans, self.duration_s, self.dt_s) > 0):
            raise ModelError(f"scale: got {self}, expected rising ranges and times above 0")

    def range_of(self, side: Side) -> tuple[float, float]:
        """Lowest and highest signal on a side."""
        return self.command if side == "command" else self.angle_deg


@dataclass(frozen=True)
class Free:
    """A parameter that a diagnosis identifies, in scale-free numbers.

    Attributes:
        name: without the number of a term: `tau_s` also stands for `tau_2_s` and `tau_up_s`.
        size: what one of it is: `span` of the signal, a `place` in it counted from its lowest value, 1 over it or
            a power of it or over the `duration`, or 1.
        lower, upper: bounds of the search; physical bounds hold as well.
        typical: values to start from, each worth a start of its own.
    """

    name: str
    size: str
    lower: float
    upper: float
    typical: tuple[float, ...]

    def at(self, scale: Scale, side: Side, parameter: Parameter) -> Start:
        """The same in units of the parameter, within its physical bounds."""
        low, high = scale.range_of(side)
        span, minutes = high - low, scale.duration_s / 60
        origin, unit = {
            "1": (0.0, 1.0),
            "span": (0.0, span),
            "place": (low, span),
            "1/span": (0.0, 1 / span),
            "1/span^2": (0.0, 1 / span**2),
            "span/duration": (0.0, span / minutes),
            "1/duration": (0.0, 1 / minutes),
        }[self.size]

        def value(number: float) -> float:
            return min(max(origin + number * unit, parameter.lower), parameter.upper)

        return Start(value(self.lower), value(self.upper), tuple(value(v) for v in self.typical))


@dataclass(frozen=True)
class Start:
    """Bounds of a search and values to start from, in units of the parameter."""

    lower: float
    upper: float
    typical: tuple[float, ...]


@dataclass(frozen=True)
class Effect:
    """One effect of the library.

    Attributes:
        name: public name.
        operator: its class.
        sides: where it may act, the side that fits devices best first.
        neutral: values that make it the identity; other parameters do not matter then.
        free: what a diagnosis identifies; other parameters stay at their defaults.
        defaults: values of parameters that may be left out besides the neutral ones.
        equation: as one line.
        apart: what separates it from its neighbours.
        why_side: why a side is missing.
        clocks: states that start at zero with a trial.
    """

    name: str
    operator: type[Operator]
    sides: tuple[Side, ...]
    neutral: Mapping[str, float]
    free: tuple[Free, ...]
    equation: str
    apart: str
    defaults: Mapping[str, float]
    why_side: str = ""
    clocks: tuple[str, ...] = ()

    def neutral_values(self, operator: Operator) -> tuple[float, ...]:
        """Values of `operator` with those of `neutral` in their places: the identity."""
        pairs = zip(operator.parameters, operator.values, strict=True)
        return tuple(self.neutral.get(base_name(parameter.name), value) for parameter, value in pairs)

    def optional(self, name: str) -> float | None:
        """Value of a parameter that was left out, None if it has to be given."""
        base = base_name(name)
        return self.neutral.get(base, self.defaults.get(base))

    def search(self, operator: Operator, scale: Scale, side: Side) -> dict[str, Start]:
        """Bounds and typical values of every free parameter of `operator`, by name."""
        free = {f.name: f for f in self.free}
        return {
            p.name: free[base_name(p.name)].at(scale, side, p) for p in operator.parameters if base_name(p.name) in free
        }

    def starts(self, operator: Operator, scale: Scale, side: Side) -> tuple[tuple[float, ...], ...]:
        """Parameter values to start a search from: every combination of the typical values of free parameters."""
        found = self.search(operator, scale, side)
        choices = [
            found[p.name].typical if p.name in found else (value,)
            for p, value in zip(operator.parameters, operator.values, strict=True)
        ]
        return tuple(itertools.product(*choices))


def base_name(name: str) -> str:
    """Name of a parameter without the number of its term or the direction: `tau_2_s` and `tau_up_s` are `tau_s`."""
    return _WAY.sub("", _NUMBER.sub("", name))


def unit_on(unit: str, side: Side) -> str:
    """A unit with `in` replaced by what the signal has on a side: cmd or deg."""
    return re.sub(r"\bin\b", "cmd" if side == "command" else "deg", unit)
