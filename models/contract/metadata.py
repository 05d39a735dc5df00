"""Metadata of a model file: sample time, units, limits, trained ranges, initial state and origin."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.types import Vec

FORMAT = "hystmpc-model/1"
TWO_AXES_FORMAT = "hystmpc-two-axes-model/1"
"""Of an ONNX file of two axes, which programs of other people open."""

PREFIX = "hystmpc."
Start = Literal["initial", "conditioned"]
"""Which rule of a model file makes the state at the start."""

# Bounds far beyond any device of this field; values beyond mean a damaged or hostile file, or another unit.
SampleTime = Annotated[float, Field(ge=1e-5, le=100.0)]  # s: 100 kHz to one sample in 100 s
Amount = Annotated[float, Field(ge=-1e9, le=1e9)]  # mm, bar or deg; counts of an encoder in a raw log
Rate = Annotated[float, Field(ge=1e-9, le=1e12)]  # amounts per second
StateEntry = Annotated[float, Field(ge=-1e18, le=1e18)]
LARGEST_STATE = 100_000  # entries
LONGEST_WARMUP = 1_000_000  # samples


class Range(Settings):
    """Closed interval, lower < upper, in the unit of the bounded quantity; both ends within 1e9 of zero.

    Attributes:
        lower: lower end.
        upper: upper end.
    """

    lower: Amount
    upper: Amount

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lower >= self.upper:
            raise ValueError(f"lower {self.lower:.6g} is not below upper {self.upper:.6g}")
        return self

    def contains(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Whether each value lies in the interval, ends included; False for not-a-number. Shape as given."""
        array = np.asarray(values, dtype=np.float64)
        return np.asarray((array >= self.lower) & (array <= self.upper))


@dataclass(frozen=True)
class DeviceLimits:
    """Limits of the command sent to the device; None means the range in the trials.

    Attributes:
        command: least and greatest command [mm or bar].
        rate_per_s: greatest change of the command [mm/s or bar/s].
    """

    command: Range | None = None
    rate_per_s: float | None = None


class InitialRule(Settings):
    """State of a device at rest at the measured angle y [deg] and the command u, entry by entry:

        x0 = offset + slope y + by_command (u - at_command)

    At most 100,000 entries, each number within 1e18 of zero.

    Attributes:
        offset, slope: of the state (S,) by the angle.
        by_command: of the state by the command (S,); empty, as in older files, where the rule holds at one command.
        at_command: command at which the device rests where none is given [command unit].
    """

    offset: tuple[StateEntry, ...] = Field(max_length=LARGEST_STATE)
    slope: tuple[StateEntry, ...] = Field(max_length=LARGEST_STATE)
    by_command: tuple[StateEntry, ...] = Field(default=(), max_length=LARGEST_STATE)
    at_command: Amount = 0.0

    @model_validator(mode="after")
    def _same_size(self) -> Self:
        if len(self.offset) != len(self.slope):
            raise ValueError(f"offset has {len(self.offset)} entries, slope {len(self.slope)}, expected as many")
        if self.by_command and len(self.by_command) != len(self.offset):
            raise ValueError(f"by_command has {len(self.by_command)} entries, expected none or {len(self.offset)}")
        return self

    def state(self, y: Vec, u: Vec | None = None) -> Vec:
        """States (N, S) from measured angles y (N, 1) [deg] and, where given, commands u (N, 1)."""
        states = np.asarray(self.offset, dtype=np.float64) + np.asarray(self.slope, dtype=np.float64) * y
        if u is None or not self.by_command:
            return states
        return states + np.asarray(self.by_command, dtype=np.float64) * (u - self.at_command)

    def behind(self, cut: int) -> InitialRule:
        """Rule of the entries from number `cut` on."""
        parts = {"offset": self.offset[cut:], "slope": self.slope[cut:], "by_command": self.by_command[cut:]}
        return self.model_copy(update=parts)


Sigma = Annotated[float, Field(ge=0, le=1e12)]


def rest_within(rest_command: float | None, lower: float, upper: float) -> float:
    """Command at rest within the limits; the lower limit where no rest command is given.

    Args:
        rest_command: value in the model's file, or None; zero is a rest command like any other.
        lower, upper: least and greatest command that is sent.
    """
    return lower if rest_command is None else min(max(rest_command, lower), upper)


def slow_error(squares: Sequence[float], samples: Sequence[int]) -> float:
    """Error of free runs on motions that are not among the trials [deg].

        sigma^2 = max(m, 0) + s,  m = sum_i w_i c_i,  s^2 = n / (n - 1) sum_i w_i^2 (c_i - m)^2

    c_i is the mean product of neighbouring residuals of trial i of n, and w_i its share of the samples. White noise of
    the sensor has no such product. The mean of a trial is an error like any other: without a sensor nothing takes it
    off. A few motions say little of others, so that one standard error s of m by its scatter is added.

    Args:
        squares: c_i of each trial [deg^2].
        samples: of each trial.
    """
    products, weights = np.array(squares), np.array(samples) / sum(samples)
    mean = float(weights @ products)
    scatter = float(np.sum((weights * (products - mean)) ** 2)) * len(squares) / max(len(squares) - 1, 1)
    return math.sqrt(max(mean, 0.0) + math.sqrt(scatter))


class NoiseModel(Settings):
    """Unexplained part of the measurement for an estimator: white noise of the sensor on a random walk.

        y_k - model_k = d_k + v_k,   var(v_k) = sensor^2,   var(d_{k+1} - d_k) = drift^2 dt + motion^2 |u_{k+1} - u_k|

    Attributes:
        sensor_sigma_deg: standard deviation of v [deg].
        drift_sigma_deg_per_sqrt_s: of the change of d over one second [deg/sqrt(s)].
        motion_sigma_deg_per_sqrt_unit: of its change over one unit of command travel [deg/sqrt(command unit)].
        model_sigma_deg: error of the model without a sensor, on motions that it has not seen [deg], see `slow_error`.
            None in older files.
        sensor_resolution_deg: step of the sensor's readings where noise does not average over it [deg]; its error is
            part of `sensor_sigma_deg`. Zero of a continuous sensor, and in older files.
    """

    sensor_sigma_deg: Annotated[float, Field(gt=0, le=1e12)]
    drift_sigma_deg_per_sqrt_s: Sigma
    motion_sigma_deg_per_sqrt_unit: Sigma
    model_sigma_deg: Sigma | None = None
    sensor_resolution_deg: Sigma = 0.0


class Connection(Settings):
    """Operators in series or in parallel with the rest of a model's graph; their states precede those of the rest.

        series:    theta = rest(operators(u)),  a drive between command and travel
        parallel:  theta = operators(u) + rest(u),  a device and a network of what its operators leave

    Attributes:
        way: `series` or `parallel`.
        chain: the operators, as in a simulator file.
    """

    way: Literal["series", "parallel"]
    chain: dict[Literal["before", "core", "after"], Any]


class ModelMetadata(Settings):
    """Facts that every model file must hold, with the bounds within which they are accepted.

    In the file every field is one entry of `metadata_props`, key `hystmpc.<field>`, value JSON.

    Attributes:
        format: layout of graph and metadata; another version is refused.
        kind: what the model is, for messages and reports ("backlash", "prandtl_ishlinskii", "chain", "lstm", ...).
        dt_s: sample time of one step [s], 1e-5 to 100.
        command_unit, angle_unit: units of `u` and `theta`: mm or bar and deg, or those of another device. An inverse
            map has them exchanged: its input `u` is an angle [deg], its output `theta` a command, and "command" and
            "angle" below mean these.
        inverse: whether it is an inverse map; None, as in older files, where one unit alone is deg and tells.
        command_limits: limits of the command sent to the device [command unit], within 1e9 of zero.
        command_rate: greatest change of the command [command unit/s], 1e-9 to 1e12.
        trained_command, trained_angle: ranges in the identification trials [command unit], [deg], within 1e9 of zero.
        trained_rate: fastest command change in the identification trials [command unit/s], 1e-9 to 1e12.
        initial: start of a recorded trial of a device that was not flexed since it was set up.
        conditioned: start of a device that has done its initialisation flexure; what controllers start from.
        warmup_samples: samples of the first command, held and unscored, before the first output counts; at most 1e6.
        training_data_hash: fingerprint of the trials that the model was identified on.
        training: free facts (name as `preset`, seed, validation error, logs).
        noise: part of the trials that the model does not explain; None where it was not estimated.
        connections: operators that are connected with the model of kind `kind`, the outermost first.
        rest_command: at which the device rests before a motion; None for the lower end of its command.
        chain: the operators of which the graph was made, as in a simulator file. From them follows the exact state at
            rest at any command and angle; the rules hold at the rest command. None for other kinds of model.

    A file may lack the last four and `inverse`.
    """

    format: str = FORMAT
    noise: NoiseModel | None = None  # not the last one: a file that is cut off lacks what follows
    connections: tuple[Connection, ...] = ()
    rest_command: Amount | None = None
    chain: dict[Literal["before", "core", "after"], Any] | None = None
    kind: str = Field(min_length=1)
    dt_s: SampleTime
    command_unit: str = Field(min_length=1)
    angle_unit: str = "deg"
    inverse: bool | None = None
    command_limits: Range
    command_rate: Rate
    trained_command: Range
    trained_angle: Range
    trained_rate: Rate
    initial: InitialRule
    conditioned: InitialRule
    warmup_samples: int = Field(ge=0, le=LONGEST_WARMUP)
    training_data_hash: str
    training: dict[str, str | float | int | bool] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.format != FORMAT:
            raise ValueError(f"format is {self.format!r}, this version of hystmpc reads {FORMAT!r}")
        if self.inverse is None and (self.angle_unit == "deg") == (self.command_unit == "deg"):
            raise ValueError(
                f"command_unit is {self.command_unit!r} and angle_unit is {self.angle_unit!r}, expected 'deg' for one: "
                "the angle of a forward model, the command of an inverse map; or `inverse`, which tells them apart"
            )
        if len(self.initial.offset) != len(self.conditioned.offset):
            raise ValueError(
                f"initial has {len(self.initial.offset)} state entries, conditioned "
                f"{len(self.conditioned.offset)}, expected as many"
            )
        return self

    @property
    def inverted(self) -> bool:
        """Whether this is an inverse map, from angle to command."""
        return self.command_unit == "deg" if self.inverse is None else self.inverse

    @property
    def model_sigma_deg(self) -> float:
        """Error of free runs on other motions [deg], see `NoiseModel`; not-a-number where unknown."""
        known = None if self.noise is None else self.noise.model_sigma_deg
        said = self.training.get("model_sigma_deg", math.nan) if known is None else known
        return float(said) if isinstance(said, float | int) else math.nan

    @property
    def rests_at(self) -> float:
        """Command at which the device rests before a motion, see `rest_within`."""
        return rest_within(self.rest_command, self.command_limits.lower, self.command_limits.upper)

    @property
    def by_inputs(self) -> bool:
        """Whether parameters of its operators depend on measured inputs, see `models.scheduled`."""
        sides = (
            ()
            if self.chain is None
            else (*self.chain.get("before", ()), self.chain["core"], *self.chain.get("after", ()))
        )
        return any("depends_on" in operator for operator in sides)

    @property
    def state_size(self) -> int:
        """Number S of state entries."""
        return len(self.initial.offset)

    def rule(self, start: Start) -> InitialRule:
        """Rule for the initial state."""
        return self.initial if start == "initial" else self.conditioned

    @classmethod
    def of(cls, **facts: Any) -> Self:
        """Metadata of a new model.

        Raises:
            ModelError: one line, if a fact is missing or out of its bounds.
        """
        try:
            return cls.parse(facts, "model")
        except ConfigError as error:
            raise ModelError(str(error)) from None

    def to_properties(self) -> dict[str, str]:
        """Keys and JSON values for `metadata_props`."""
        return {PREFIX + key: json.dumps(value) for key, value in self.model_dump(mode="json").items()}

    @classmethod
    def from_properties(cls, properties: Mapping[str, str], where: str) -> Self:
        """Metadata from the entries written by `to_properties`; other keys are ignored.

        Raises:
            ModelError: if there is no such metadata, it is of another version, or a field is missing or out of bounds.
        """
        ours = {key.removeprefix(PREFIX): text for key, text in properties.items() if key.startswith(PREFIX)}
        if "format" not in ours:
            raise ModelError(
                f"{where}: foreign ONNX file, no '{PREFIX}format' in its metadata, "
                "expected a file written by export_onnx"
            )
        fields = {key: _decode(text, f"{where}: metadata {PREFIX}{key}") for key, text in ours.items()}
        if fields["format"] == TWO_AXES_FORMAT:
            raise ModelError(
                f"{where}: is an exported model of two axes, which hystmpc does not open: use the model file (.yaml) "
                "from which it was exported"
            )
        if fields["format"] != FORMAT:
            raise ModelError(
                f"{where}: model format {fields['format']!r}, this version of hystmpc reads {FORMAT!r}; "
                "export the model again"
            )
        # fields with other defaults are needed too: a file that is cut off lacks them
        needed = [key for key in cls.model_fields if key not in _OPTIONAL]
        missing = [key for key in needed if key not in ours]
        if missing:
            raise ModelError(f"{where}: metadata lacks {', '.join(missing)}; the file is cut off or was edited")
        try:
            return cls.parse(fields, f"{where}: metadata")
        except ConfigError as error:
            raise ModelError(str(error)) from None


_OPTIONAL = ("noise", "connections", "inverse", "rest_command", "chain")


def _decode(text: str, where: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ModelError(f"{where}: got {text[:40]!r}, expected JSON") from None
