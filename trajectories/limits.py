"""Limits of a motion."""

from __future__ import annotations

from dataclasses import dataclass

from .checks import require_positive


@dataclass(frozen=True)
class MotionLimits:
    """Greatest speed, acceleration and jerk of a tip-angle reference, either way.

    The defaults let a tendon catheter be driven at the 6 mm/s that S2 (RA-L 2024, PMC11633443) used, at about
    10 deg/mm, with ramps of a few tenths of a second.

    Attributes:
        velocity_deg_s: [deg/s].
        acceleration_deg_s2: [deg/s^2].
        jerk_deg_s3: [deg/s^3].

    Raises:
        TrajectoryError: if a limit is not finite and positive.
    """

    velocity_deg_s: float = 60.0
    acceleration_deg_s2: float = 300.0
    jerk_deg_s3: float = 3000.0

    def __post_init__(self) -> None:
        require_positive(
            velocity_deg_s=self.velocity_deg_s,
            acceleration_deg_s2=self.acceleration_deg_s2,
            jerk_deg_s3=self.jerk_deg_s3,
        )

    def __str__(self) -> str:
        return f"{self.velocity_deg_s:g} deg/s, {self.acceleration_deg_s2:g} deg/s^2, {self.jerk_deg_s3:g} deg/s^3"
