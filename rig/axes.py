"""Quantities of one axis, which are numbers, and of two axes, which are pairs: the loop passes on both alike."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from hystmpc.ctrl.command import CommandLimits
from hystmpc.trials.config import OfBothAxes, Positive, Settings
from hystmpc.trials.layouts import CANONICAL, command_column
from hystmpc.trials.trial import MOST_INPUTS
from hystmpc.trials.types import Vec

PerAxis = float
"""A number of one axis; of two axes a tuple of both. Type checkers see the number, with which one axis works."""

NAMES = ("x", "y")
"""Names of two axes in columns, faults and messages."""

_COLUMNS = frozenset(
    ("time", "command", "angle", "reference", "predicted", "period", "lateness", "sequence", "wall", "source")
    + ("status", "faults", "missed", "stage")
)


def _free_names(names: tuple[str, ...]) -> tuple[str, ...]:
    for k, name in enumerate(names):
        if name in names[:k] or name.partition("_")[0] in _COLUMNS:
            raise ValueError(f"got {name}, expected each input once, by a name that begins as no other column of a log")
    return names


InputName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$", max_length=40)]
InputNames = Annotated[tuple[InputName, ...], Field(max_length=MOST_INPUTS), AfterValidator(_free_names)]
"""Names of the measured inputs of a reading in their order, such as `pressure_bar`; each gets a column of the log."""


def from_the_first(values: Vec) -> Vec:
    """Values (N,) of a measured input; those before the first number are that number. Empty without a number."""
    known = np.flatnonzero(np.isfinite(values))
    return np.where(np.arange(values.size) < known[0], values[known[0]], values) if known.size else values[:0]


def each(value: Any) -> tuple[Any, ...]:
    """Values of all axes, of a value of one axis or a tuple of two."""
    return value if isinstance(value, tuple) else (value,)


def together(values: Iterable[float]) -> PerAxis:
    """A number of one axis, or a tuple of two axes, of the values of all axes; inverse of `each`."""
    several: Any = tuple(values)
    return several[0] if len(several) == 1 else several


def spread(value: Any, axes: int) -> tuple[float, ...]:
    """Values of `axes` axes; not-a-number for all where the count is another."""
    values = each(value)
    return values if len(values) == axes else (math.nan,) * axes


def like(other: PerAxis, value: PerAxis) -> PerAxis:
    """The value, or not-a-number for all axes of the other one where its count is another."""
    return value if not isinstance(other, tuple) else together(spread(value, len(other)))


def rows_of(array: Vec) -> list[PerAxis]:
    """Numbers of an array (N,), or tuples of an array (N, 2)."""
    return [together(row) for row in array.tolist()] if array.ndim > 1 else array.tolist()


def from_array(value: Any) -> PerAxis:
    """A number of one axis as it is, or a tuple of an array (2,)."""
    plain = value.tolist() if hasattr(value, "ndim") else value
    return together(plain) if isinstance(plain, list) else plain


def is_known(value: PerAxis) -> bool:
    """Whether the value is finite in every axis."""
    return all(map(math.isfinite, value)) if isinstance(value, tuple) else math.isfinite(value)


def is_near(value: PerAxis, other: PerAxis, tolerance: float) -> bool:
    """Whether two values differ by `tolerance` at most in every axis; False for not-a-number, or another count."""
    if not isinstance(value, tuple) and not isinstance(other, tuple):  # what is left is for two axes
        return abs(value - other) <= tolerance
    here, there = each(value), each(other)
    return len(here) == len(there) and all(abs(a - b) <= tolerance for a, b in zip(here, there, strict=True))


def in_words(value: PerAxis, form: str = ".6g") -> str:
    """Text of a value for messages: `1.5`, or `(1.5, -2)` of two axes."""
    texts = [format(one, form) for one in each(value)]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"


def of_axis(text: str, axis: int, axes: int) -> str:
    """A message of one of several axes, which begins with its name; unchanged of a single axis, or where empty."""
    return f"{NAMES[axis]}: {text}" if text and axes > 1 else text


def columns(name: str, value: PerAxis, axes: int) -> dict[str, float]:
    """Value by column: `angle_deg` of one axis; `angle_x_deg` and `angle_y_deg` of two."""
    if axes == 1:
        return {name: value}
    stem, _, unit = name.partition("_")
    names = [f"{stem}_{axis}_{unit}".removesuffix("_") for axis in NAMES]
    return dict(zip(names, spread(value, axes), strict=True))


def trial_columns(t: Vec, commands: Vec, angles_deg: Vec, unit: str) -> dict[str, Vec]:
    """Columns of a trial of two axes, as `fit` reads it.

    Args:
        t: times (T,) [s].
        commands: of both axes (T, 2), in the unit.
        angles_deg: (T, 2) [deg].
        unit: of the commands, mm or bar.
    """
    made = {CANONICAL.time: t}
    for name, values in ((command_column(unit), commands), (CANONICAL.angle, angles_deg)):
        made |= dict(zip(columns(name, math.nan, len(NAMES)), values.T, strict=True))
    return made


class PlaneLimitsSettings(Settings):
    """Hard limits of the commands of two axes, in lists `[x, y]`.

    Attributes:
        lower: least commands [mm or bar].
        upper: greatest commands [mm or bar].
        rate_per_s: greatest change of each command [mm/s or bar/s].
    """

    lower: Annotated[tuple[float, float], OfBothAxes]
    upper: Annotated[tuple[float, float], OfBothAxes]
    rate_per_s: Annotated[tuple[Positive, Positive], OfBothAxes]

    @model_validator(mode="after")
    def _ordered(self) -> PlaneLimitsSettings:
        for name, low, high in zip(NAMES, self.lower, self.upper, strict=True):
            if not low < high:
                raise ValueError(f"got lower {low} and upper {high} of {name}, expected lower < upper")
        return self

    def build(self) -> tuple[CommandLimits, ...]:
        """Limits of both commands."""
        return tuple(map(CommandLimits, self.lower, self.upper, self.rate_per_s))


class ModelledPlaneLimitsSettings(PlaneLimitsSettings):
    """The same where a model is known: wider than those of the model only with `beyond_model`.

    Attributes:
        beyond_model: whether the limits may be wider than those that the model was made for.
    """

    beyond_model: Annotated[bool, Field(strict=True)] = False
