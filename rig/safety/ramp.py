"""Commands of jerk-limited ramps, one for each sample."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hystmpc.trajectories.motion import Kinematics, MotionLimits, PiecewiseCubic, Segments, hold
from hystmpc.trajectories.ruckig_ import move_to_rest, move_together
from hystmpc.trials.config import Positive, Settings
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from ..axes import PerAxis, each, together


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


def ramp_commands(start: PerAxis, velocity: PerAxis, target: PerAxis, ramps: RampSettings, dt_s: float) -> Vec:
    """Commands (N,) from `start`, moving at `velocity`, to rest at `target`, which is the last one.

    Of two axes commands (N, 2), which arrive at the same time.

    Raises:
        TrajectoryError: if ruckig finds no motion.
    """
    targets = each(target)
    moves = _moves(list(map(Kinematics, each(start), each(velocity))), targets, ramps)
    motions = [PiecewiseCubic(segments) if segments.size else None for segments in moves]
    longest_s = max(0.0 if motion is None else motion.duration_s for motion in motions)
    t = dt_s * np.arange(1, max(1, math.ceil(longest_s / dt_s - 1e-9)) + 1)
    made = [np.full(t.size, end) if motion is None else motion(t) for motion, end in zip(motions, targets, strict=True)]
    for commands, end in zip(made, targets, strict=True):
        commands[-1] = end
    return made[0] if len(made) == 1 else np.stack(made, axis=1)


def stop_commands(
    start: PerAxis, velocity: PerAxis, safe: PerAxis, ramps: RampSettings, overshoot: float, dt_s: float
) -> Vec:
    """Commands (N,) of a stop from `start`, moving at `velocity`, to rest at `safe`; of two axes (N, 2).

    The jerk-limited ramp where it stays between `start` and `safe` within `overshoot` at either end. Otherwise it
    brakes first, with a linear velocity, which takes |v| / a and travels v^2 / (2 a), and ramps from rest:

        a = max(acceleration_per_s2, v^2 / (2 overshoot)), or brake_per_s2

    Two axes brake each by itself, if one of them has to. The ramp begins when both are at rest, and both arrive at the
    same time.

    Raises:
        TrajectoryError: if ruckig finds no motion.
    """
    ramp = ramp_commands(start, velocity, safe, ramps, dt_s)
    starts, ends = np.array(each(start)), np.array(each(safe))
    low, high = np.minimum(starts, ends) - overshoot, np.maximum(starts, ends) + overshoot
    if np.all(low <= ramp.min(axis=0)) and np.all(ramp.max(axis=0) <= high):
        return ramp
    brakes = [_braking(*one, ramps, overshoot, dt_s) for one in zip(each(start), each(velocity), strict=True)]
    longest = max(one.size for one in brakes)
    brakes = [np.pad(one, (0, longest - one.size), "edge") for one in brakes]
    braking = brakes[0] if len(brakes) == 1 else np.stack(brakes, axis=1)
    rest, still = together(float(one[-1]) for one in brakes), together(0.0 for _ in brakes)
    return np.concatenate([braking, ramp_commands(rest, still, safe, ramps, dt_s)])


def _braking(start: float, velocity: float, ramps: RampSettings, overshoot: float, dt_s: float) -> Vec:
    """Commands (N,) of one axis from a velocity to rest, at least one."""
    brake = ramps.brake_per_s2 or max(ramps.acceleration_per_s2, velocity**2 / (2.0 * overshoot))
    lasts_s = abs(velocity) / brake
    t = np.minimum(dt_s * np.arange(1, max(1, math.ceil(lasts_s / dt_s)) + 1), lasts_s)
    return np.asarray(start + velocity * t - math.copysign(0.5 * brake, velocity) * t**2)


def waypoint_commands(
    start: PerAxis, stops: Sequence[PerAxis], holds_s: Sequence[float], ramps: RampSettings, dt_s: float
) -> Vec:
    """Commands (N,) of ramps from rest at `start` to every stop, each followed by its hold; of two axes (N, 2).

    Raises:
        TrajectoryError: if ruckig finds no motion, or there is nothing to do.
    """
    now = each(start)
    pieces: list[list[Segments]] = [[] for _ in now]
    for stop, rest_s in zip(stops, holds_s, strict=True):
        moves = _moves(list(map(Kinematics, now)), each(stop), ramps)
        for one, move, end in zip(pieces, moves, each(stop), strict=True):
            one += [move, hold(end, rest_s)]
        now = each(stop)
    segments = [np.vstack(one) if one else np.empty((0, 5)) for one in pieces]
    segments = [one[one[:, 0] > 0] for one in segments]
    if not segments[0].size:
        raise TrajectoryError(f"command motion: got stops {list(stops)} from {start}, expected some motion or hold")
    motions = [PiecewiseCubic(one) for one in segments]
    steps = max(1, math.ceil(max(motion.duration_s for motion in motions) / dt_s - 1e-9))
    commands = [motion(dt_s * np.arange(1, steps + 1)) for motion in motions]
    return commands[0] if len(commands) == 1 else np.stack(commands, axis=1)


def _moves(starts: Sequence[Kinematics], targets: Sequence[float], ramps: RampSettings) -> list[Segments]:
    """Segments of the moves of all axes to rest; those of two axes end at the same time."""
    if len(starts) == 1:
        return [move_to_rest(starts[0], targets[0], ramps.limits)]
    return move_together(starts, targets, ramps.limits)
