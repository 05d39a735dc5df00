"""From angle to angle at rest, with holds: ruckig moves one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .motion import Kinematics, MotionLimits, PiecewiseCubic, Segments, hold
from .ruckig_ import move
from .trajectory import PathTrajectory, require_finite, require_range


def rest_to_rest(start_deg: float, target_deg: float, limits: MotionLimits) -> PiecewiseCubic:
    """The fastest jerk-limited move from rest to rest.

    Raises:
        TrajectoryError: if start and target are the same, or an angle is not finite.
    """
    require_finite(start_deg=start_deg, target_deg=target_deg)
    leg = move(Kinematics(start_deg), Kinematics(target_deg), limits)
    return PiecewiseCubic(np.vstack((leg, hold(target_deg, 0.0))))


@dataclass(frozen=True)
class PointToPoint(PathTrajectory):
    """Moves from target to target, each as fast as the limits allow and each followed by a hold.

    A target equal to the one before (to 1e-12 of the angle) is snapped to it and adds its hold only.

    Attributes:
        start_deg: angle at time 0 [deg].
        targets_deg: angles to reach, in order [deg].
        holds_s: time to rest at each target [s], as many as targets, zero allowed.
        limits: greatest velocity, acceleration and jerk of every move.

    Raises:
        TrajectoryError: if a number is not finite, a hold is negative, the counts differ, or nothing moves or
            holds at all.
    """

    start_deg: float
    targets_deg: Sequence[float]
    holds_s: Sequence[float]
    limits: MotionLimits = field(default_factory=MotionLimits)
    _path: PiecewiseCubic = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets_deg", tuple(float(x) for x in self.targets_deg))
        object.__setattr__(self, "holds_s", tuple(float(x) for x in self.holds_s))
        if not self.targets_deg or len(self.targets_deg) != len(self.holds_s):
            raise TrajectoryError(
                f"point to point: got {len(self.targets_deg)} targets and {len(self.holds_s)} holds, "
                "expected as many of one as of the other, at least 1"
            )
        require_finite(start_deg=self.start_deg)
        for k, (target, rest) in enumerate(zip(self.targets_deg, self.holds_s, strict=True)):
            require_finite(**{f"targets_deg[{k}]": target})
            require_range(f"holds_s[{k}]", (rest, rest), least=0.0)
        self._follow(PiecewiseCubic(self._segments()))

    def _segments(self) -> Segments:
        pieces, at = [], self.start_deg
        for target, rest in zip(self.targets_deg, self.holds_s, strict=True):
            leg = move(Kinematics(at), Kinematics(target), self.limits)
            at = target if leg.size else at
            pieces += [leg, hold(at, rest)]
        return np.vstack(pieces)

    def derivative(self, t: ArrayLike, order: int) -> Vec:
        """Velocity (1), acceleration (2) or jerk (3) at `t` [s]."""
        return self._path.derivative(t, order)


def random_point_to_point(
    seed: int | np.random.Generator,
    *,
    start_deg: float,
    range_deg: tuple[float, float],
    moves: int = 10,
    hold_range_s: tuple[float, float] = (1.0, 5.0),
    limits: MotionLimits | None = None,
) -> PointToPoint:
    """Point to point with uniformly drawn targets and holds; equal seeds give equal motions.

    Args:
        seed: seed, or a generator to draw from.
        start_deg: angle at time 0 [deg].
        range_deg: least and greatest target [deg].
        moves: number of targets, at least 1.
        hold_range_s: shortest and longest hold [s].
        limits: of every move; None for the defaults of MotionLimits.

    Raises:
        TrajectoryError: if a range is empty or not finite, or no move is asked for.
    """
    require_range("range_deg", range_deg)
    require_range("hold_range_s", hold_range_s, least=0.0)
    if moves < 1:
        raise TrajectoryError(f"moves: got {moves}, expected at least 1")
    rng = np.random.default_rng(seed)
    targets, holds = rng.uniform(*range_deg, moves), rng.uniform(*hold_range_s, moves)
    return PointToPoint(start_deg, targets.tolist(), holds.tolist(), limits or MotionLimits())
