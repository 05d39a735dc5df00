"""Point-to-point motions with holds, of successive jerk-limited moves."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from hystmpc.trials.config import Count, NotNegative
from hystmpc.trials.errors import TrajectoryError

from .motion import (
    Bounds,
    Kinematics,
    MotionLimits,
    MotionSettings,
    NotNegativeBounds,
    PathMotion,
    PiecewiseCubic,
    hold,
)
from .ruckig_ import move


class PointToPoint(PathMotion):
    """Point-to-point motion: moves from target to target, each as fast as the limits allow and followed by a hold.

    A target equal to the one before (to 1e-12 of the angle) adds its hold only.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        targets_deg: angles to reach, in order [deg].
        holds_s: time to rest at each target [s]; as many as targets, 0 allowed.
        limits: greatest velocity, acceleration and jerk of every move.

    Raises:
        TrajectoryError: if a number is out of bounds, the counts differ, or nothing moves or holds at all.
    """

    kind: Literal["point_to_point"] = "point_to_point"
    start_deg: float
    targets_deg: tuple[float, ...] = Field(min_length=1)
    holds_s: tuple[NotNegative, ...]
    limits: MotionLimits = MotionLimits()

    @cached_property
    def path(self) -> PiecewiseCubic:
        """Path of moves and holds, one after another.

        Raises:
            TrajectoryError: if the counts differ, or nothing moves or holds.
        """
        if len(self.targets_deg) != len(self.holds_s):
            raise TrajectoryError(
                f"point to point: got {len(self.targets_deg)} targets and {len(self.holds_s)} holds, expected as many"
            )
        pieces, at = [], self.start_deg
        for target, rest in zip(self.targets_deg, self.holds_s, strict=True):
            leg = move(Kinematics(at), Kinematics(target), self.limits)
            at = target if leg.size else at
            pieces += [leg, hold(at, rest)]
        return PiecewiseCubic(np.vstack(pieces))


class RandomPointToPointSettings(MotionSettings):
    """Random point-to-point motion with uniformly drawn targets and holds; see `random_point_to_point`.

    Attributes:
        seed: of the random numbers.
        start_deg: angle at time 0, at rest [deg].
        range_deg: lowest and highest target [deg].
        moves: number of moves.
        hold_range_s: shortest and longest hold [s].
        limits: greatest velocity, acceleration and jerk of every move.
    """

    kind: Literal["random_point_to_point"] = "random_point_to_point"
    seed: int = Field(ge=0)
    start_deg: float
    range_deg: Bounds
    moves: Count = 10
    hold_range_s: NotNegativeBounds = (1.0, 5.0)
    limits: MotionLimits = MotionLimits()

    def build(self, folder: Path | str = ".") -> PointToPoint:
        del folder
        return self.drawn(np.random.default_rng(self.seed))

    def drawn(self, random: np.random.Generator) -> PointToPoint:
        """Draw one motion from `random`."""
        targets, holds = random.uniform(*self.range_deg, self.moves), random.uniform(*self.hold_range_s, self.moves)
        return PointToPoint(
            start_deg=self.start_deg,
            targets_deg=tuple(targets.tolist()),
            holds_s=tuple(holds.tolist()),
            limits=self.limits,
        )


def random_point_to_point(seed: int | np.random.Generator, **settings: Any) -> PointToPoint:
    """Draw a point-to-point motion with uniform targets and holds; equal seeds give equal motions.

    Raises:
        TrajectoryError: if a range is empty or not finite, or no move is asked for.
    """
    return RandomPointToPointSettings(seed=0, **settings).drawn(np.random.default_rng(seed))
