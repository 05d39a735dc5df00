"""Working units: log units times powers of ten that bring every device to about the same size."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, fields, replace
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .chain import Chain
from .contract.metadata import NoiseModel, Range
from .effects.effect import Side, unit_on
from .operators.operator import Operator

_ROUNDING = 1e-9  # share of a decade that is a rounding error
_SUFFIXES = {"_deg": "deg", "_deg_s": "deg/s"}
_FACTOR = re.compile(r"([a-z]+|1)(?:\^(\d))?")


class _Record(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


_R = TypeVar("_R", bound=_Record)


@dataclass(frozen=True)
class Decades:
    """Working units in which the command has a range of 1 to 10 and the output a range of 10 to 100.

    These are the sizes of a tendon catheter in mm and deg, for which starts, bounds and thresholds of an identification
    are stated. Powers of ten leave a device of these sizes unchanged.

    Attributes:
        command, angle: units of the log in one working unit.
    """

    command: float = 1.0
    angle: float = 1.0

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> Self:
        """Working units for the device of some trials, swapped or not."""
        spans = [max((float(np.ptp(signal)) for signal in signals), default=0.0) for signals in _signals(trials)]
        return cls._of_spans(*spans)

    @classmethod
    def of_ranges(cls, command: Range, angle: Range) -> Self:
        """Working units for these ranges of command and output."""
        return cls._of_spans(command.upper - command.lower, angle.upper - angle.lower)

    @classmethod
    def _of_spans(cls, command: float, angle: float) -> Self:
        return cls(10.0 ** _decade(command), 10.0 ** (_decade(angle) - 1))

    @property
    def usual(self) -> bool:
        """Whether the working units equal those of the log."""
        return self.command == self.angle == 1.0

    def trial(self, trial: Trial) -> Trial:
        """Trial in working units, under the unit names of the log."""
        factors = (self.angle, self.command) if trial.inverted else (self.command, self.angle)
        if self.usual:
            return trial
        return replace(trial, command=trial.command / factors[0], angle=trial.angle / factors[1])

    def trials(self, trials: Sequence[Trial]) -> list[Trial]:
        """Trials in working units."""
        return [self.trial(trial) for trial in trials]

    def chain(self, chain: Chain) -> Chain:
        """Chain in working units."""
        return self._converted(chain, -1)

    def log_chain(self, chain: Chain) -> Chain:
        """Chain converted from working units to log units."""
        return self._converted(chain, 1)

    def log_value(self, value: float, unit: str) -> float:
        """Number converted from working units to log units; `unit` is written with `cmd` and `deg`, as `deg/cmd`."""
        return value * self.in_log(unit)

    def output(self, trials: Sequence[Trial]) -> float:
        """Log units in one working unit of the predicted quantity: the angle, or the command for swapped trials."""
        return self.command if trials and trials[0].inverted else self.angle

    def log_noise(self, noise: NoiseModel) -> NoiseModel:
        """Noise model converted from working units to log units."""
        model = noise.model_sigma_deg
        return NoiseModel(
            sensor_sigma_deg=noise.sensor_sigma_deg * self.angle,
            drift_sigma_deg_per_sqrt_s=noise.drift_sigma_deg_per_sqrt_s * self.angle,
            motion_sigma_deg_per_sqrt_unit=noise.motion_sigma_deg_per_sqrt_unit * self.angle / math.sqrt(self.command),
            model_sigma_deg=None if model is None else model * self.angle,
            sensor_resolution_deg=noise.sensor_resolution_deg * self.angle,
        )

    def log_sizes(self, row: _R) -> _R:
        """Record converted to log units, in the fields that end in `_deg` or `_deg_s`."""
        named = [(f.name, unit) for f in fields(row) for end, unit in _SUFFIXES.items() if f.name.endswith(end)]
        return replace(row, **{name: _times(getattr(row, name), self.in_log(unit)) for name, unit in named})

    def in_log(self, unit: str) -> float:
        """Log units in one working unit of a quantity in `unit`, such as `deg s/cmd`; 1 without `cmd` and `deg`."""
        return size_of(unit, {"cmd": self.command, "deg": self.angle})

    def log_operator(self, operator: Operator, side: Side) -> Operator:
        """Operator on that side converted from working units to log units."""
        return self._operator(operator, side, 1)

    def _converted(self, chain: Chain, way: int) -> Chain:
        if self.usual:
            return chain
        return Chain(
            self._operator(chain.core, "output", way),
            tuple(self._operator(operator, "command", way) for operator in chain.before),
            tuple(self._operator(operator, "output", way) for operator in chain.after),
        )

    def _operator(self, operator: Operator, side: Side, way: int) -> Operator:
        factors = [self.in_log(unit_on(parameter.unit, side)) ** way for parameter in operator.parameters]
        values = zip(operator.values, factors, strict=True)
        return operator.with_values([v * factor for v, factor in values])


def size_of(unit: str, sizes: Mapping[str, float]) -> float:
    """Size of a compound unit such as `cmd s^2/deg` from the sizes of its parts; a unit without a size counts 1."""

    def product(part: str) -> float:
        matches = [match for factor in part.split() if (match := _FACTOR.fullmatch(factor))]
        return math.prod(sizes.get(match[1], 1.0) ** int(match[2] or 1) for match in matches)

    above, *below = unit.split("/")
    return product(above) / math.prod(map(product, below))


def _signals(trials: Sequence[Trial]) -> tuple[list[Vec], list[Vec]]:
    devices = [trial.swapped() if trial.inverted else trial for trial in trials]
    return [trial.command for trial in devices], [trial.angle for trial in devices]


def _times(value: Any, factor: float) -> Any:
    return tuple(factor * end for end in value) if isinstance(value, tuple) else factor * value


def _decade(span: float) -> int:
    return math.floor(math.log10(span) + _ROUNDING) if span > 0 and math.isfinite(span) else 0
