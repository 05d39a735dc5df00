"""What a candidate cause is, and the sizes that candidates are made in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hystmpc.models.operators.operator import Operator

from .recording import Run

Side = Literal["command", "output"]
CORE = "core"  # variant of an effect that is a freedom of the core and no operator of its own


@dataclass(frozen=True)
class Freedom:
    """One parameter that a fit may move.

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
    """One effect at one place.

    Attributes:
        effect: its public name.
        variant: tells apart several forms of one effect.
        side: of the command, before everything that is there, or of the output, behind it.
        order: place among the candidates of a side; small ones come first in the order of the signal.
        operators: in the order of the signal; `starts` overwrite their free parameters. None at all for a freedom of
            the core itself.
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


@dataclass(frozen=True)
class Scale:
    """What sizes of effects are measured in.

    Attributes:
        low, high: range of the command [cmd].
        angle_low, angle_high: range of the angle [deg].
        duration_s: of the longest trial [s].
        total_s: of all trials together [s].
        dt_s: sample time [s].
    """

    low: float
    high: float
    angle_low: float
    angle_high: float
    duration_s: float
    total_s: float
    dt_s: float

    @property
    def span(self) -> float:
        """Range of the command [cmd]."""
        return self.high - self.low

    @property
    def angle_span(self) -> float:
        """Range of the angle [deg]."""
        return self.angle_high - self.angle_low

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Scale:
        """Read off trials; angles by their 1 and 99 % quantiles, so that an outlier does not count."""
        command = np.concatenate([run.command for run in runs])
        angle = np.quantile(np.concatenate([run.angle for run in runs]), (0.01, 0.99))
        durations = [run.command.size * run.dt_s for run in runs]
        return cls(
            float(command.min()),
            float(command.max()),
            float(angle[0]),
            float(angle[1]),
            max(durations),
            sum(durations),
            runs[0].dt_s,
        )
