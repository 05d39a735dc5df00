"""Trajectories one after another."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .trajectory import Trajectory, inside


@dataclass(frozen=True, eq=False)
class Chain:
    """Parts played one after another; each must begin where the one before it ends.

    Attributes:
        parts: at least one trajectory.

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
