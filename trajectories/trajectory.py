"""Trajectories: interface, sampled signals, chains of trajectories, previews."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

# Rounding of a duration of whole samples must not cost one more sample.
_ROUNDING = 1e-9


class Trajectory(Protocol):
    """Signal over time: a tip-angle reference [deg], or a command excitation [mm or bar]."""

    @property
    def duration_s(self) -> float:
        """Time from start to end [s], above zero."""
        ...

    def __call__(self, t: ArrayLike) -> Vec:
        """Return the values at the times `t` [s]; before 0 the start value, after the end the end value."""
        ...


def inside(t: ArrayLike, duration_s: float) -> Vec:
    """Clip times `t` [s] to 0..duration_s, so that start and end values hold outside."""
    return np.clip(np.asarray(t, dtype=np.float64), 0.0, duration_s)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Sampled signal with linear interpolation; time counts from the first sample.

    Attributes:
        t: times [s], shape (T,), strictly increasing.
        values: tip angles [deg] (or commands) at these times, shape (T,).

    Raises:
        TrajectoryError: if shapes differ, fewer than two samples are given, a number is not finite, or time does
            not increase.
    """

    t: Vec
    values: Vec

    def __post_init__(self) -> None:
        t, values = np.array(self.t, dtype=np.float64), np.array(self.values, dtype=np.float64)
        if t.ndim != 1 or t.shape != values.shape or t.size < 2:
            raise TrajectoryError(
                f"samples: got times {t.shape} and values {values.shape}, expected the same (T,) with T >= 2"
            )
        bad = np.flatnonzero(~(np.isfinite(t) & np.isfinite(values)))
        if bad.size:
            k = int(bad[0])
            raise TrajectoryError(f"sample {k}: got t {t[k]}, value {values[k]}, expected finite numbers")
        late = np.flatnonzero(np.diff(t) <= 0)
        if late.size:
            k = int(late[0])
            raise TrajectoryError(
                f"sample {k + 1}: got t {t[k + 1]:.6g} s after {t[k]:.6g} s, expected strictly increasing time"
            )
        for name, array in (("t", t - t[0]), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1])

    def __call__(self, t: ArrayLike) -> Vec:
        """Interpolated values at `t` [s]."""
        return np.asarray(np.interp(np.asarray(t, dtype=np.float64), self.t, self.values))


def steps(duration_s: float, dt: float) -> int:
    """Return the number of samples of length `dt` [s] that cover `duration_s` [s]."""
    return math.ceil(duration_s / dt - _ROUNDING)


def sample(trajectory: Trajectory, rate_hz: float) -> tuple[Vec, Vec]:
    """Sample a trajectory from 0 to its end, including the end.

    The last time is the first multiple of 1 / rate_hz at or after the end, where the end value holds.

    Returns:
        Times [s] and values, each of shape (T,).

    Raises:
        TrajectoryError: if the rate is not finite and positive.
    """
    require_positive(rate_hz=rate_hz)
    t = np.arange(steps(trajectory.duration_s, 1.0 / rate_hz) + 1) / rate_hz
    return t, trajectory(t)


@dataclass(frozen=True, eq=False)
class TrajectoryChain:
    """Trajectories one after another; each must begin where the one before it ends.

    Raises:
        TrajectoryError: if there is no part.
    """

    parts: tuple[Trajectory, ...]
    _starts: Vec = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.parts:
            raise TrajectoryError("chain: got no part, expected at least one trajectory")
        ends = np.cumsum([part.duration_s for part in self.parts])
        object.__setattr__(self, "_starts", np.concatenate(([0.0], ends)))

    @property
    def duration_s(self) -> float:
        """Sum of the parts' durations [s]."""
        return float(self._starts[-1])

    def __call__(self, t: ArrayLike) -> Vec:
        """Values at `t` [s]."""
        time = inside(t, self.duration_s)
        part = np.minimum(np.searchsorted(self._starts, time, side="right"), len(self.parts)) - 1
        values = np.empty(time.shape)
        for k, trajectory in enumerate(self.parts):
            here = part == k
            values[here] = trajectory(time[here] - self._starts[k])
        return values


COLUMNS = ("time_s", "angle_deg")


def read_sampled(path: Path | str) -> Sampled:
    """Read a sampled reference from a CSV file; additional columns are ignored.

    Raises:
        TrajectoryError: naming file and row, if the file cannot be read, a column is missing, a value is not a
            number, or the samples are not a trajectory.
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TrajectoryError(f"{path}: cannot be read ({error}), expected a CSV file") from None
    names = [name.strip() for name in header]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise TrajectoryError(f"{path}: no column {missing[0]}, available: {', '.join(names) or 'none'}")
    places = [names.index(name) for name in COLUMNS]
    values = [_numbers(row, places, f"{path}: row {k}") for k, row in enumerate(rows, start=2) if row]
    try:
        return Sampled(*np.array(values, dtype=np.float64).reshape(-1, 2).T)
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from None


def _numbers(row: list[str], places: list[int], where: str) -> list[float]:
    numbers = []
    for place, name in zip(places, COLUMNS, strict=True):
        text = row[place] if place < len(row) else ""
        try:
            numbers.append(float(text))
        except ValueError:
            raise TrajectoryError(f"{where}: {name} is {text!r}, expected a number") from None
    return numbers


def preview(trajectory: Trajectory, t: float, dt: float, horizon: int) -> Vec:
    """Return the values (H,) at t + dt, t + 2 dt, ..., t + H dt [s], H = `horizon`; the end value past the end.

    Raises:
        TrajectoryError: if `dt` is not positive or the horizon is less than 1.
    """
    _require_preview(dt, horizon)
    return trajectory(t + dt * np.arange(1, horizon + 1))


@dataclass(frozen=True, eq=False)
class PreviewTable:
    """Table of the previews at every sample of a run, computed in advance: a look-up is a slice.

    Attributes:
        horizon: samples per preview H, at least 1.

    Raises:
        TrajectoryError: if `dt` is not positive or the horizon is less than 1.
    """

    trajectory: Trajectory
    dt: float
    horizon: int
    _values: Vec = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _require_preview(self.dt, self.horizon)
        values = self.trajectory(self.dt * np.arange(self.steps + self.horizon + 1))
        values.setflags(write=False)
        object.__setattr__(self, "_values", values)

    @property
    def steps(self) -> int:
        """Number of samples that cover the trajectory."""
        return steps(self.trajectory.duration_s, self.dt)

    def value(self, k: int) -> float:
        """Return the reference at time k dt."""
        return float(self._values[self._row(k)])

    def at(self, k: int) -> Vec:
        """Return the preview at time k dt: the values at (k + 1) dt, ..., (k + H) dt, shape (H,), read-only.

        Raises:
            TrajectoryError: if `k` is negative.
        """
        row = self._row(k)
        return self._values[row + 1 : row + 1 + self.horizon]

    def _row(self, k: int) -> int:
        if k < 0:
            raise TrajectoryError(f"preview: got sample {k}, expected 0 or later")
        return min(k, self.steps)


def _require_preview(dt: float, horizon: int) -> None:
    require_positive(dt=dt)
    if horizon < 1:
        raise TrajectoryError(f"preview horizon: got {horizon}, expected at least 1 sample")


def require_positive(**values: float) -> None:
    """Refuse values that are not finite and above zero.

    Raises:
        TrajectoryError: at the first such value.
    """
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise TrajectoryError(f"{name}: got {value}, expected a finite number > 0")
