"""Free of units: identifications work in powers of ten of the log's units, in which every device has the same size."""

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

_ROUNDING = 1e-9  # of a decade: a range that is 10 but for rounding is 10
_SUFFIXES = {"_deg": "deg", "_deg_s": "deg/s"}
_FACTOR = re.compile(r"([a-z]+|1)(?:\^(\d))?")


class _Record(Protocol):
    """A dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


_R = TypeVar("_R", bound=_Record)


@dataclass(frozen=True)
class Decades:
    """Working units: a command's range is 1 to 10 of them, an output's 10 to 100.

    These are the sizes of a tendon catheter in mm and deg, for which starts, bounds and thresholds of an identification
    are stated. Any other device is brought to them: its trials on the way in, what was identified on the way out.
    Powers of ten, so that a device which has these sizes is left as it is.

    Attributes:
        command, angle: units of the log in one working unit.
    """

    command: float = 1.0
    angle: float = 1.0

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> Self:
        """The working units of a device; of swapped trials as of the device that they are from."""
        spans = [max((float(np.ptp(signal)) for signal in signals), default=0.0) for signals in _signals(trials)]
        return cls._of_spans(*spans)

    @classmethod
    def of_ranges(cls, command: Range, angle: Range) -> Self:
        """The working units of a device whose command and output have these ranges."""
        return cls._of_spans(command.upper - command.lower, angle.upper - angle.lower)

    @classmethod
    def _of_spans(cls, command: float, angle: float) -> Self:
        return cls(10.0 ** _decade(command), 10.0 ** (_decade(angle) - 1))

    @property
    def usual(self) -> bool:
        """Whether they are the log's own."""
        return self.command == self.angle == 1.0

    def trial(self, trial: Trial) -> Trial:
        """A trial in working units; they go by the names of the log's."""
        factors = (self.angle, self.command) if trial.inverted else (self.command, self.angle)
        if self.usual:
            return trial
        return replace(trial, command=trial.command / factors[0], angle=trial.angle / factors[1])

    def trials(self, trials: Sequence[Trial]) -> list[Trial]:
        """Trials in working units."""
        return [self.trial(trial) for trial in trials]

    def chain(self, chain: Chain) -> Chain:
        """A chain in working units."""
        return self._converted(chain, -1)

    def log_chain(self, chain: Chain) -> Chain:
        """A chain in working units, brought back to the units of the log."""
        return self._converted(chain, 1)

    def log_value(self, value: float, unit: str) -> float:
        """A number in working units, brought back; `unit` with `cmd` and `deg`, as `deg/cmd`."""
        return value * self.in_log(unit)

    def output(self, trials: Sequence[Trial]) -> float:
        """Log units in one working unit of what is predicted: the angle, of swapped trials the command."""
        return self.command if trials and trials[0].inverted else self.angle

    def log_noise(self, noise: NoiseModel) -> NoiseModel:
        """Noise of a model in working units, brought back."""
        model = noise.model_sigma_deg
        return NoiseModel(
            sensor_sigma_deg=noise.sensor_sigma_deg * self.angle,
            drift_sigma_deg_per_sqrt_s=noise.drift_sigma_deg_per_sqrt_s * self.angle,
            motion_sigma_deg_per_sqrt_unit=noise.motion_sigma_deg_per_sqrt_unit * self.angle / math.sqrt(self.command),
            model_sigma_deg=None if model is None else model * self.angle,
            sensor_resolution_deg=noise.sensor_resolution_deg * self.angle,
        )

    def log_sizes(self, row: _R) -> _R:
        """A record in working units, brought back: numbers, arrays and pairs whose names end in `_deg` or `_deg_s`."""
        named = [(f.name, unit) for f in fields(row) for end, unit in _SUFFIXES.items() if f.name.endswith(end)]
        return replace(row, **{name: _times(getattr(row, name), self.in_log(unit)) for name, unit in named})

    def in_log(self, unit: str) -> float:
        """Log units in one working unit of a quantity, as `deg s/cmd` or `1/deg^2`; 1 of what has none of these."""
        return size_of(unit, {"cmd": self.command, "deg": self.angle})

    def log_operator(self, operator: Operator, side: Side) -> Operator:
        """An operator in working units that acts on that side, brought back."""
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
    """Size of a quantity from those of the units in its own, such as `cmd s^2/deg`; a unit without a size counts 1."""

    def product(part: str) -> float:
        matches = [match for factor in part.split() if (match := _FACTOR.fullmatch(factor))]
        return math.prod(sizes.get(match[1], 1.0) ** int(match[2] or 1) for match in matches)

    above, *below = unit.split("/")
    return product(above) / math.prod(map(product, below))


def _signals(trials: Sequence[Trial]) -> tuple[list[Vec], list[Vec]]:
    """Commands and outputs of the device."""
    devices = [trial.swapped() if trial.inverted else trial for trial in trials]
    return [trial.command for trial in devices], [trial.angle for trial in devices]


def _times(value: Any, factor: float) -> Any:
    return tuple(factor * end for end in value) if isinstance(value, tuple) else factor * value


def _decade(span: float) -> int:
    return math.floor(math.log10(span) + _ROUNDING) if span > 0 and math.isfinite(span) else 0
