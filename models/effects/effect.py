"""Effects: an operator with sides and neutral values, and the forms that a diagnosis tests."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from hystmpc.trials.types import Vec

from ..operators.operator import Operator
from ..scheduled import Dependence

Side = Literal["command", "output"]
CORE = "core"  # variant of an effect that is a free parameter of the core instead of an operator

_NUMBER = re.compile(r"_\d+(?=_|$)")
_WAY = re.compile(r"_(up|down)(?=_|$)")


class RecordedTrial(Protocol):
    """Interface of a recorded trial from which sizes are computed."""

    @property
    def command(self) -> Vec:
        """Commands (T,) [cmd]."""
        ...

    @property
    def angle(self) -> Vec:
        """Angles (T,) [deg]."""
        ...

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        ...


@dataclass(frozen=True)
class Scale:
    """Sizes of a device and its trials, used to scale the forms of effects.

    Attributes:
        low, high: range of the command [cmd].
        angle_low, angle_high: range of the angle [deg].
        duration_s: of the longest trial [s].
        total_s: of all trials together [s].
        fastest: greatest speed of the command [cmd/s]; where unknown, that of a step over its range.
    """

    low: float
    high: float
    angle_low: float
    angle_high: float
    duration_s: float
    total_s: float
    dt_s: float
    fastest: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "fastest", min(self.fastest, self.span / self.dt_s))

    @property
    def span(self) -> float:
        """Range of the command [cmd]."""
        return self.high - self.low

    @property
    def angle_span(self) -> float:
        """Range of the angle [deg]."""
        return self.angle_high - self.angle_low

    @classmethod
    def of(cls, runs: Sequence[RecordedTrial]) -> Scale:
        """Sizes of trials; the angle's range is between its 1 and 99 % quantiles, so that outliers do not count."""
        command = np.concatenate([run.command for run in runs])
        angle = np.quantile(np.concatenate([run.angle for run in runs]), (0.01, 0.99))
        durations = [run.command.size * run.dt_s for run in runs]
        low, high, angle_low, angle_high = map(float, (command.min(), command.max(), angle[0], angle[1]))
        steps = np.concatenate([np.abs(np.diff(run.command)) for run in runs])
        dt_s, fastest = runs[0].dt_s, float(steps.max(initial=0.0)) / runs[0].dt_s
        return cls(low, high, angle_low, angle_high, max(durations), sum(durations), dt_s, fastest)


@dataclass(frozen=True)
class Freedom:
    """Free parameter of a fit.

    Attributes:
        lower, upper: bounds, physical signs included.
        scale: a typical change; 0 for a positive parameter that is searched on a logarithmic scale.
    """

    name: str
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class Candidate:
    """One form of an effect at one place of the chain.

    Attributes:
        effect: its public name.
        variant: name of the form.
        side: command side, before all present operators, or output side, behind them.
        order: place among the candidates of a side; small numbers come first in the order of the signal.
        operators: in the order of the signal; `starts` overwrite their free parameters. Empty for a freedom of the core
            itself.
        free: parameters that are identified; operators with the same parameter share its value.
        starts: starting values of the free parameters; never exactly neutral, where a shape parameter would have no
            gradient.
        carries: memory taken over from earlier trials: `bend` for a running maximum, `clock`, or nothing.
        depends: dependence of present operators on a measured input; then there are no operators.
    """

    effect: str
    variant: str
    side: Side
    order: int
    operators: tuple[Operator, ...]
    free: tuple[Freedom, ...]
    starts: tuple[tuple[float, ...], ...]
    carries: Literal["", "bend", "clock"] = ""
    depends: Dependence | None = None

    @property
    def label(self) -> str:
        """Effect and variant."""
        return f"{self.effect}/{self.variant}"


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Effect of the library.

    Attributes:
        apart: what separates it from its neighbours.
        neutral: values that make it the identity; other parameters do not matter then.
        sides: possible sides, the side that fits devices best first.
        defaults: values of parameters that may be left out besides the neutral ones.
        clocks: states that start at zero with a trial.
        forms: candidates that a diagnosis tests, sized by the data; empty where it has its own test.
        other_forms: further operators that represent this effect and have no name in a diagnosis.
        confounders: effects that some motions cannot distinguish from it.
        also_taken_for: effects that are easily mistaken for it although motions differ.
        separated_by: motions needed to distinguish it from its confounders: `fast` moves, `speeds` (ramps at several),
            `holds`, `long_holds`, a `repeat`, `amplitudes`.
        generic: whether it can imitate almost any other effect, which makes its diagnosis less specific.
        shown: parameter values with a visible effect on the plain device of the pictures, on the first side; one
            mapping for each trial shown.
    """

    operator: type[Operator]
    equation: str
    apart: str
    neutral: Mapping[str, float]
    shown: tuple[Mapping[str, float], ...]
    sides: tuple[Side, ...] = ("command", "output")
    why_side: str = ""
    defaults: Mapping[str, float] | None = None
    clocks: tuple[str, ...] = ()
    forms: Callable[[Scale], Sequence[Candidate]] = lambda scale: ()
    other_forms: tuple[type[Operator], ...] = ()
    confounders: tuple[str, ...] = ()
    also_taken_for: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()
    generic: bool = False

    @property
    def name(self) -> str:
        """Public name."""
        return self.operator.name

    def neutral_values(self, operator: Operator) -> tuple[float, ...]:
        """Parameter values with which `operator` is the identity."""
        pairs = zip(operator.parameters, operator.values, strict=True)
        return tuple(self.neutral.get(base_name(parameter.name), value) for parameter, value in pairs)

    def optional(self, name: str) -> float | None:
        """Default of a parameter that was left out; None if it is required."""
        base = base_name(name)
        return self.neutral.get(base, (self.defaults or {}).get(base))


def base_name(name: str) -> str:
    """Parameter name without term number or direction: `tau_2_s` and `tau_up_s` become `tau_s`."""
    return _WAY.sub("", _NUMBER.sub("", name))


def unit_on(unit: str, side: Side) -> str:
    """Unit with `in` replaced by the unit of the signal on a side: cmd or deg."""
    return re.sub(r"\bin\b", "cmd" if side == "command" else "deg", unit)
