"""Motions of the study: three minutes of commands to identify from, and fresh references to follow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trajectories.drawn import CountedMotion, drawn_motions
from hystmpc.trajectories.excitation import DecayingSine, RampHoldDraw
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .device import DrawnPlant

SCANS_HZ = {"scan": 0.2, "fast_scan": 0.6}
_INNER, _OUTER = 0.03, 0.97  # of the travel, in identification
_SLOPE_SHARE = 0.35  # of the greatest speed that the fast scan may ask for
_RETURN, _REST_S = 0.3, 1.0  # share of the greatest speed on the way back to rest, and the rest there
_QUICK = 0.25  # of the full length


def recordings(plant: DrawnPlant, quick: bool = False) -> tuple[Trial, ...]:
    """Trials of three minutes in all at the device's rate, each from the rest after a reset.

    Steps and ramps with holds, one long hold, slow, middling and fast sines, and reversals at random.
    """
    limits, share = plant.device.limits, _QUICK if quick else 1.0
    random = np.random.default_rng([plant.device.seed, 1])
    return tuple(
        _recorded(plant.reseeded(int(random.integers(2**31))), motion, name)
        for name, motion in _excitations(limits, random, share)
    )


def _excitations(limits: CommandLimits, random: np.random.Generator, share: float) -> Iterator[tuple[str, Trajectory]]:
    """Commands by name; `share` of the full length, 180 s in all at 1 with the ways back to rest."""
    stroke, rate = limits.upper, limits.rate
    ends = (_INNER * stroke, _OUTER * stroke)
    steps = RampHoldDraw(max(round(20 * share), 3), ends, (0.1 * rate, 0.8 * rate), (1.0, 4.0), (0.1 * stroke, stroke))
    yield "steps", _cut(steps(random), 38.0 * share)
    holds = RampHoldDraw(max(round(8 * share), 1), ends, (0.05 * rate, 0.3 * rate), (6.0, 9.0), (0.2 * stroke, stroke))
    yield "long_holds", _cut(holds(random), 33.0 * share)
    half = 0.5 * (_OUTER * stroke)
    yield "slow_sine", DecayingSine(half, 0.1, 0.0, 28.0 * share)
    yield "shrinking_sine", DecayingSine(half, 0.25, 0.06, 24.0 * share, lift=1.0)
    yield "fast_sine", DecayingSine(0.3 * stroke, 0.6, 0.0, 14.0 * share, lift=1.0)
    turns = RampHoldDraw(200, ends, (0.05 * rate, 0.5 * rate), (0.0, 0.2), (0.05 * stroke, 0.6 * stroke))
    yield "reversals", _cut(turns(random), 33.0 * share)


@dataclass(frozen=True)
class _Cut:
    """The beginning of a trajectory."""

    whole: Trajectory
    duration_s: float

    def __call__(self, t: object) -> Vec:
        return self.whole(np.minimum(np.asarray(t, dtype=np.float64), self.duration_s))


def _cut(whole: Trajectory, longest_s: float) -> Trajectory:
    return _Cut(whole, min(longest_s, whole.duration_s))


def _recorded(plant: DrawnPlant, motion: Trajectory, name: str) -> Trial:
    """Command and the angle measured at the end of the sample over which it was held; it ends with a way back to rest.

    The command keeps to the limit of its speed.
    """
    limits, dt = plant.device.limits, plant.dt
    asked = motion(dt * np.arange(round(motion.duration_s / dt) + 1, dtype=np.float64))
    back = np.arange(asked[-1], limits.lower, -_RETURN * limits.rate * dt)
    held = np.full(round(_REST_S / dt), limits.lower)
    command = limits.clip_plans(np.concatenate([asked, back, held]), plant.rest_command, dt)
    t = dt * np.arange(command.size, dtype=np.float64)
    plant.reset()
    angle = np.array([plant.apply(float(u)) for u in command])
    return Trial(np.round(t, 6), command, angle, units=Units(command=plant.command_unit), source=name)


def fresh_motions(plant: DrawnPlant, quick: bool = False) -> tuple[CountedMotion, ...]:
    """Point to point with holds, a scan and a fast scan, over ranges drawn within what the device reaches."""
    random = np.random.default_rng([plant.device.seed, 2])
    speed = _SLOPE_SHARE * _speed(plant)
    moves, scan_s = (2, 0.0) if quick else (5, 10.0)
    return drawn_motions(random, plant.true_angle, plant.reachable_deg, speed, SCANS_HZ, moves=moves, scan_s=scan_s)


def _speed(plant: DrawnPlant) -> float:
    """Mean slope times the greatest change of the command [deg/s]."""
    low, high = plant.reachable_deg
    limits = plant.device.limits
    return (high - low) / limits.upper * limits.rate
