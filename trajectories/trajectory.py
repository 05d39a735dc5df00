"""What a trajectory is, the sampled one, and sampling any."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .checks import require_positive

# A duration that is a whole number of samples but for rounding must not cost one sample more.
_ROUNDING = 1e-9


class Trajectory(Protocol):
    """A signal over time: a tip-angle reference [deg], or a command excitation [mm or bar]."""

    @property
    def duration_s(self) -> float:
        """Time from start to end [s], above zero."""
        ...

    def __call__(self, t: ArrayLike) -> Vec:
        """Value at the times `t` [s], of the shape of `t`; before 0 the start value, after the end the end value."""
        ...


def inside(t: ArrayLike, duration_s: float) -> Vec:
    """Times `t` [s] clipped to 0..duration_s, so that start and end values hold outside."""
    return np.clip(np.asarray(t, dtype=np.float64), 0.0, duration_s)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Linear interpolation between samples; time counts from the first of them.

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
    """Number of samples of length `dt` [s] that cover `duration_s` [s]."""
    return math.ceil(duration_s / dt - _ROUNDING)


def sample(trajectory: Trajectory, rate_hz: float) -> tuple[Vec, Vec]:
    """Sample a trajectory from 0 to its end, the end included.

    The last time is the first multiple of 1 / rate_hz at or after the end, where the end value holds.

    Args:
        trajectory: what to sample.
        rate_hz: samples per second.

    Returns:
        Times [s] and values, each of shape (T,).

    Raises:
        TrajectoryError: if the rate is not finite and positive.
    """
    require_positive(rate_hz=rate_hz)
    t = np.arange(steps(trajectory.duration_s, 1.0 / rate_hz) + 1) / rate_hz
    return t, trajectory(t)
