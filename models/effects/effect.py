"""Effects: an operator with sides and neutral values, and the forms in which a diagnosis tests for it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from hystmpc.trials.types import Vec

from ..operators.operator import Operator

Side = Literal["command", "output"]
CORE = "core"  # variant of an effect that is a freedom of the core and no operator of its own

_STILL = 1e-4  # of the range of the command: it stands still if it changes less from sample to sample
_NUMBER = re.compile(r"_\d+(?=_|$)")
_WAY = re.compile(r"_(up|down)(?=_|$)")


class RecordedTrial(Protocol):
    """RecordedTrial trial, from which sizes are read."""

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
    """Sizes of a device and its trials, in which the forms of effects are stated.

    Attributes:
        low, high: range of the command [cmd].
        angle_low, angle_high: range of the angle [deg].
        duration_s: of the longest trial [s].
        total_s: of all trials together [s].
        dt_s: sample time [s].
        resting: share of the time in which the command stands still.
        fastest: greatest speed of the command [cmd/s]; where it is not known, that of a step over its range.
    """

    low: float
    high: float
    angle_low: float
    angle_high: float
    duration_s: float
    total_s: float
    dt_s: float
    resting: float = 1.0
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
        """Scale of trials; angles by their 1 and 99 % quantiles, so that an outlier does not count."""
        command = np.concatenate([run.command for run in runs])
        angle = np.quantile(np.concatenate([run.angle for run in runs]), (0.01, 0.99))
        durations = [run.command.size * run.dt_s for run in runs]
        low, high, angle_low, angle_high = map(float, (command.min(), command.max(), angle[0], angle[1]))
        steps = np.concatenate([np.abs(np.diff(run.command)) for run in runs])
        resting = float(np.mean(steps <= _STILL * (high - low))) if steps.size else 0.0
        dt_s, fastest = runs[0].dt_s, float(steps.max(initial=0.0)) / runs[0].dt_s
        return cls(low, high, angle_low, angle_high, max(durations), sum(durations), dt_s, resting, fastest)


@dataclass(frozen=True)
class Freedom:
    """One parameter that a fit may change.

    Attributes:
        name: of the parameter.
        lower, upper: bounds, physical signs included.
        scale: a typical change; 0 for a positive parameter that is searched on a logarithmic scale.
    """

    name: str
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class Candidate:
    """One effect in one form, at one place of the chain.

    Attributes:
        effect: its public name.
        variant: name of the form.
        side: of the command, before everything that is there, or of the output, behind it.
        order: place among the candidates of a side; small ones come first in the order of the signal.
        operators: in the order of the signal; `starts` overwrite their free parameters. Empty for a freedom of the
            core itself.
        free: parameters that are identified; operators that share one have it in common.
        starts: values of the free parameters from which a fit begins; never exactly neutral, where a shape parameter
            would have no gradient.
        carries: what the state takes over from earlier trials: `bend` for a running maximum, `clock`, or nothing.
    """

    effect: str
    variant: str
    side: Side
    order: int
    operators: tuple[Operator, ...]
    free: tuple[Freedom, ...]
    starts: tuple[tuple[float, ...], ...]
    carries: Literal["", "bend", "clock"] = ""

    @property
    def label(self) -> str:
        """Effect and variant."""
        return f"{self.effect}/{self.variant}"


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect of the library.

    Attributes:
        operator: its class, whose name is the effect's.
        equation: as one line.
        apart: what separates it from its neighbours.
        neutral: values that make it the identity; other parameters do not matter then.
        sides: where it may act, the side that fits devices best first.
        why_side: why a side is missing.
        defaults: values of parameters that may be left out besides the neutral ones.
        clocks: states that start at zero with a trial.
        forms: what a diagnosis adds to a simulator to test for it, sized by the data; empty where it has its own test.
        other_forms: further operators that stand for this effect and have no name of their own in a diagnosis.
        confounders: effects that some motions cannot tell from it.
        also_taken_for: effects that it is easily taken for although motions differ.
        separated_by: what motions have to contain for it to be told from its confounders: `fast` moves, `speeds`
            (ramps at several), `holds`, `long_holds`, a `repeat`, `amplitudes`.
        generic: whether it can imitate almost any other effect, so that finding it means less.
        shown: parameter values that are large enough to be seen on the plain device of the pictures, on the first
            side; one mapping for each trial shown.
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
        """Values of `operator` with those of `neutral` in their places: the identity."""
        pairs = zip(operator.parameters, operator.values, strict=True)
        return tuple(self.neutral.get(base_name(parameter.name), value) for parameter, value in pairs)

    def optional(self, name: str) -> float | None:
        """Value of a parameter that was left out, None if it has to be given."""
        base = base_name(name)
        return self.neutral.get(base, (self.defaults or {}).get(base))


def base_name(name: str) -> str:
    """Name of a parameter without the number of its term or the direction: `tau_2_s` and `tau_up_s` are `tau_s`."""
    return _WAY.sub("", _NUMBER.sub("", name))


def unit_on(unit: str, side: Side) -> str:
    """A unit with `in` replaced by what the signal has on a side: cmd or deg."""
    return re.sub(r"\bin\b", "cmd" if side == "command" else "deg", unit)
