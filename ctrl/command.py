"""Command of one step, inputs of a control law, and hard limits of command and rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, final

import numpy as np
from pydantic import Field, model_validator

from hystmpc.core.library import engine
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.trials.brief import brief
from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.errors import ControllerError, shown
from hystmpc.trials.types import Vec

T = TypeVar("T")

EMPTY: Vec = np.empty(0)
EMPTY.setflags(write=False)


class Source(StrEnum):
    """Fallback level that produced a command, best first."""

    CONTROLLER = "controller"  # feedforward or feedback law
    MPC = "mpc"
    SHIFTED_PLAN = "shifted plan"
    INVERSE = "inverse"
    HOLD = "hold"
    STOP = "stop"


@dataclass(frozen=True)
class Timing:
    """Computing time of each stage of one step [s]; stages that did not run are missing."""

    stages: Mapping[str, float] = field(default_factory=dict)

    @property
    def total_s(self) -> float:
        """Total computing time [s]."""
        return sum(self.stages.values())


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Command:
    """Command to the device, with the plan and the prediction behind it.

    Attributes:
        u: command [mm or bar], always finite and within the limits on value and rate.
        status: `ok`, or one line on what was unusual or why a better level was not used.
        plan: planned commands over the horizon, shape (H,), empty where the controller does not plan.
        predicted: predicted tip angles [deg] at the ends of this and the next samples, disturbance included: as
            many as the plan has, up to the effect of `u` where there is no plan, none without a model.
        disturbance: difference between device and given model [deg]: disturbance and learned part.
    """

    u: float
    source: Source
    status: str = "ok"
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    disturbance: float = 0.0
    timing: Timing = field(default_factory=Timing)
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class ControlInput:
    """Inputs of a control law in one step."""

    state: Vec  # predictor state (S,) at the instant at which the next command starts to act
    disturbance: float  # estimated output disturbance [deg]
    disturbance_sigma: float  # standard deviation of what noise does to it in a hold [deg]
    measured: float  # last accepted measurement [deg]
    age: float  # age of that measurement [samples]
    u_last: float  # the command really sent last [mm or bar]
    due: float  # reference angle now [deg]
    setpoint: float  # reference angle at the end of this sample [deg]
    reference: Vec  # reference angles at the ends of the samples that the next commands act in, shape (H,)
    remaining_plan: Vec  # remaining commands of the last good plan, up to H - 1 entries
    forecast_error: float = 0.0  # forecast error relative to that of no change, see `Estimate`


@final
class Stopwatch:
    """Stopwatch for the stages of one step, the only clock read by a controller."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._since = perf_counter()

    def lap(self, stage: str) -> None:
        """Add the time since the last call to `stage` [s]."""
        now = perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._since
        self._since = now


def attempt(action: Callable[[], T]) -> tuple[T | None, str]:
    """Call `action`; return its result, or None and one line on the exception, without warnings for NaNs."""
    try:
        with np.errstate(all="ignore"):
            return action(), ""
    except Exception as error:  # noqa: BLE001 - models and solvers may raise anything, the loop must go on
        return None, described(error)


def described(error: Exception) -> str:
    """Return one line on an exception: its kind and its words."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


_ROUNDING = 1e-9  # relative; a limit that was written with fewer digits


def number_of(value: object) -> float | None:
    """Convert `value` to a number; None if it is none, such as a text, a truth value or a list."""
    if type(value) is float:
        return value
    if isinstance(value, str | bytes | bytearray | bool | np.bool_ | complex | np.complexfloating):
        return None
    try:
        return float(value)  # type: ignore[arg-type]  # anything may come from outside
    except Exception:  # noqa: BLE001 - what `__float__` of anything raises
        return None


def numbers_of(values: object) -> Vec:
    """Convert `values` to an array of numbers; a single not-a-number if that fails, as for ragged lists."""
    try:
        array = np.asarray(values)
        usable = array.dtype.kind in "iufO"
        return array.astype(np.float64) if usable else np.array(math.nan)
    except Exception:  # noqa: BLE001 - what `__array__` or `__float__` of anything raises
        return np.array(math.nan)


@dataclass(frozen=True)
class CommandLimits:
    """Box and rate limits of a command: lower <= u_k <= upper, |u_k - u_{k-1}| <= rate * dt.

    Attributes:
        lower, upper: least and greatest command [mm or bar].
        rate: greatest change per second, either way [mm/s or bar/s].

    Raises:
        ControllerError: if a limit is not finite, the box is empty or the rate is not positive.
    """

    lower: float
    upper: float
    rate: float

    def __post_init__(self) -> None:
        values = [number_of(v) for v in (self.lower, self.upper, self.rate)]
        known = all(v is not None and math.isfinite(v) for v in values)
        if not known or self.lower >= self.upper or self.rate <= 0:
            raise ControllerError(
                f"command limits: got lower {shown(self.lower, 50)}, upper {shown(self.upper, 50)}, "
                f"rate {shown(self.rate, 50)}, "
                "expected finite lower < upper and rate > 0"
            )

    def __str__(self) -> str:
        return f"{self.lower:g} to {self.upper:g} at {self.rate:g} per s"

    def contains(self, other: CommandLimits) -> bool:
        """Whether `other` allows nothing beyond these limits, up to rounding."""
        slack = _ROUNDING * (self.upper - self.lower)
        inside = self.lower - slack <= other.lower and other.upper <= self.upper + slack
        return inside and other.rate <= self.rate * (1 + _ROUNDING)

    def window(self, last: float, dt: float) -> tuple[float, float]:
        """Return the least and the greatest command that may follow `last` after `dt` seconds."""
        last = min(max(last, self.lower), self.upper)
        return max(self.lower, last - self.rate * dt), min(self.upper, last + self.rate * dt)

    def clip(self, u: float, last: float, dt: float) -> float:
        """Return the nearest admissible command; `last` itself if `u` is not a finite number."""
        low, high = self.window(last, dt)
        return min(max(u if math.isfinite(u) else last, low), high)

    def clip_plans(self, plans: Vec, last: float, dt: float) -> Vec:
        """Return the nearest admissible plans (..., H), limited sample by sample; a NaN stays.

        Commands are rounded to 1e-7 of the greatest move: the slope of a play at its edge, or at rest, depends on the
        side, which must not depend on rounding errors.
        """
        admissible: Vec = np.array(plans, dtype=np.float64, order="C")
        rows = admissible.reshape(-1, admissible.shape[-1])
        engine().clip_plans(*rows.shape, self.lower, self.upper, self.rate * dt, last, rows)
        return admissible


class LimitsSettings(Settings):
    """Hard limits of the command [mm or bar] and of its rate [mm/s or bar/s].

    Attributes:
        lower: least command [mm or bar].
        upper: greatest command [mm or bar].
        rate_per_s: greatest change of the command [mm/s or bar/s].
    """

    lower: float
    upper: float
    rate_per_s: Positive

    @model_validator(mode="after")
    def _ordered(self) -> LimitsSettings:
        if not self.lower < self.upper:
            raise ValueError(f"got lower {self.lower} and upper {self.upper}, expected lower < upper")
        return self

    def build(self) -> CommandLimits:
        """Return the limits as `CommandLimits`."""
        return CommandLimits(self.lower, self.upper, self.rate_per_s)


class ModelledLimitsSettings(LimitsSettings):
    """Hard limits where a model is known: wider than those of the model only with `beyond_model`.

    Attributes:
        beyond_model: whether the limits may be wider than the command limits and rate that the model was made for; its
            predictions there are extrapolated, and the device may not be made for them either.
    """

    beyond_model: Annotated[bool, Field(strict=True)] = False


if TYPE_CHECKING:
    from dataclasses import replace as replace  # type checkers know its arguments
else:

    def replace(old: Any, /, **changes: Any) -> Any:
        """Return a copy with changed fields, as `dataclasses.replace`, for classes without `__post_init__`.

        Raises:
            TypeError: if a changed field does not exist.
        """
        new = object.__new__(type(old))
        fields = new.__dict__
        fields.update(old.__dict__)
        count = len(fields)
        fields.update(changes)
        if len(fields) != count:
            raise TypeError(f"{type(old).__name__}: got {sorted(changes)}, expected {sorted(old.__dict__)}")
        return new


def limits_of_model(facts: ModelMetadata) -> CommandLimits:
    """Return command and rate limits of a model."""
    return CommandLimits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)


def modelled_limits(settings: ModelledLimitsSettings | None, model: CommandLimits) -> CommandLimits:
    """Return the hard limits of command and rate: those of the settings, or of the model where these are left out.

    Raises:
        ControllerError: if the settings go beyond the model and do not say that they may.
    """
    if settings is None:
        return model
    limits = settings.build()
    if not (settings.beyond_model or model.contains(limits)):
        raise ControllerError(
            f"limits: got {limits}, expected them within what the model was made for, {model}; "
            "limits.beyond_model: true allows more"
        )
    return limits


def narrowed_limits(device: CommandLimits, settings: LimitsSettings | None) -> CommandLimits:
    """Return the limits of the settings, which have to lie within those of the device, or else the device's.

    Raises:
        ControllerError: if they go beyond the device's limits.
    """
    if settings is None:
        return device
    limits = settings.build()
    if not device.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within those of the device, {device}")
    return limits
