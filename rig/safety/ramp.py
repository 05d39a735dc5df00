"""Commands of jerk-limited ramps, one for each sample."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hystmpc.trajectories.motion import Kinematics, MotionLimits, PiecewiseCubic, hold
from hystmpc.trajectories.ruckig_ import move_to_rest
from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec


class RampSettings(Settings):
    """Velocity, acceleration and jerk of the command in preparation, lead-in and return, in command units.

    A stop brakes first, see `stop_commands`: with `acceleration_per_s2` where that keeps within the allowed overshoot,
    else with the deceleration that the overshoot needs, or with `brake_per_s2` where it is given.

    Attributes:
        velocity_per_s: greatest velocity [mm/s or bar/s].
        acceleration_per_s2: greatest acceleration [mm/s^2 or bar/s^2].
        jerk_per_s3: greatest jerk [mm/s^3 or bar/s^3].
        brake_per_s2: deceleration of a stop [mm/s^2 or bar/s^2]; null for the one that the allowed overshoot needs.
    """

    velocity_per_s: Positive = 2.0
    acceleration_per_s2: Positive = 10.0
    jerk_per_s3: Positive = 100.0
    brake_per_s2: Positive | None = None

    @property
    def limits(self) -> MotionLimits:
        """Same limits as settings of ruckig, whose numbers have no unit."""
        return MotionLimits(
            velocity_deg_s=self.velocity_per_s,
            acceleration_deg_s2=self.acceleration_per_s2,
            jerk_deg_s3=self.jerk_per_s3,
        )


def ramp_commands(start: float, velocity: float, target: float, ramps: RampSettings, dt_s: float) -> Vec:
    """Commands (N,) from `start`, moving at `velocity`, to rest at `target`, which is the last one.

    Raises:
        TrajectoryError: if ruckig finds no motion.
    """
    segments = move_to_rest(Kinematics(start, velocity), target, ramps.limits)
    if not segments.size:
        return np.array([target])
    motion = PiecewiseCubic(segments)
    steps = max(1, math.ceil(motion.duration_s / dt_s - 1e-9))
    commands = motion(dt_s * np.arange(1, steps + 1))
    commands[-1] = target
    return commands


def stop_commands(
    start: float, velocity: float, safe: float, ramps: RampSettings, overshoot: float, dt_s: float
) -> Vec:
    """Commands (N,) of a stop from `start`, moving at `velocity`, to rest at `safe`.

    The jerk-limited ramp where it stays between `start` and `safe` within `overshoot` at either end. Otherwise it
    brakes first, with a linear velocity, which takes |v| / a and travels v^2 / (2 a), and ramps from rest:

        a = max(acceleration_per_s2, v^2 / (2 overshoot)), or brake_per_s2

    Raises:
        TrajectoryError: if ruckig finds no motion.
    """
    ramp = ramp_commands(start, velocity, safe, ramps, dt_s)
    if min(start, safe) - overshoot <= ramp.min() and ramp.max() <= max(start, safe) + overshoot:
        return ramp
    brake = ramps.brake_per_s2 or max(ramps.acceleration_per_s2, velocity**2 / (2.0 * overshoot))
    lasts_s = abs(velocity) / brake
    t = np.minimum(dt_s * np.arange(1, math.ceil(lasts_s / dt_s) + 1), lasts_s)
    braking = start + velocity * t - math.copysign(0.5 * brake, velocity) * t**2
    return np.concatenate([braking, ramp_commands(float(braking[-1]), 0.0, safe, ramps, dt_s)])


def waypoint_commands(
    start: float, stops: Sequence[float], holds_s: Sequence[float], ramps: RampSettings, dt_s: float
) -> Vec:
    """Commands (N,) of ramps from rest at `start` to every stop, each followed by its hold.

    Raises:
        TrajectoryError: if ruckig finds no motion, or there is nothing to do.
    """
    pieces, now = [], start
    for stop, rest_s in zip(stops, holds_s, strict=True):
        pieces += [move_to_rest(Kinematics(now), stop, ramps.limits), hold(stop, rest_s)]
        now = stop
    segments = np.vstack(pieces) if pieces else np.empty((0, 5))
    segments = segments[segments[:, 0] > 0]
    if not segments.size:
        raise TrajectoryError(f"command motion: got stops {list(stops)} from {start}, expected some motion or hold")
    motion = PiecewiseCubic(segments)
    steps = max(1, math.ceil(motion.duration_s / dt_s - 1e-9))
    return motion(dt_s * np.arange(1, steps + 1))
