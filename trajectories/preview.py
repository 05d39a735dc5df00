"""What a predictive controller sees of the reference: the values at the ends of the coming samples."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .trajectory import Trajectory, require_positive, steps


def preview(trajectory: Trajectory, t: float, dt: float, horizon: int) -> Vec:
    """Values at t + dt, t + 2 dt, ..., t + H dt, shape (H,); held at the end value past the end.

    Args:
        trajectory: the reference.
        t: the present time [s].
        dt: sample time [s].
        horizon: number of samples H, at least 1.

    Raises:
        TrajectoryError: if `dt` is not positive or the horizon is less than 1.
    """
    _check(dt, horizon)
    return trajectory(t + dt * np.arange(1, horizon + 1))


@dataclass(frozen=True, eq=False)
class PreviewTable:
    """Previews at every sample of a run, computed beforehand: a look-up is a slice.

    Attributes:
        trajectory: the reference.
        dt: sample time [s].
        horizon: samples per preview H, at least 1.

    Raises:
        TrajectoryError: if `dt` is not positive or the horizon is less than 1.
    """

    trajectory: Trajectory
    dt: float
    horizon: int
    _values: Vec = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _check(self.dt, self.horizon)
        values = self.trajectory(self.dt * np.arange(self.steps + self.horizon + 1))
        values.setflags(write=False)
        object.__setattr__(self, "_values", values)

    @property
    def steps(self) -> int:
        """Number of samples that cover the trajectory."""
        return steps(self.trajectory.duration_s, self.dt)

    def value(self, k: int) -> float:
        """Reference at time k dt."""
        return float(self._values[self._row(k)])

    def at(self, k: int) -> Vec:
        """Preview at time k dt: the values at (k + 1) dt, ..., (k + H) dt, shape (H,), read-only.

        Raises:
            TrajectoryError: if `k` is negative.
        """
        row = self._row(k)
        return self._values[row + 1 : row + 1 + self.horizon]

    def _row(self, k: int) -> int:
        if k < 0:
            raise TrajectoryError(f"preview: got sample {k}, expected 0 or later")
        return min(k, self.steps)


def _check(dt: float, horizon: int) -> None:
    require_positive(dt=dt)
    if horizon < 1:
        raise TrajectoryError(f"preview horizon: got {horizon}, expected at least 1 sample")
