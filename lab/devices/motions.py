"""Motions of the study: three minutes of commands for identification, and new references for tracking."""

from __future__ import annotations

import numpy as np

from hystmpc.trajectories.drawn import CountedMotion, drawn_motions
from hystmpc.trajectories.excitation import identification_motions
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.trial import Trial, Units

from .drawn import DrawnPlant

SCANS_HZ = {"scan": 0.2, "fast_scan": 0.6}
_SLOPE_SHARE = 0.35  # of the greatest speed that the fast scan may ask for
_RETURN, _REST_S = 0.3, 1.0  # share of the greatest speed on the return, and rest there
_QUICK = 0.25  # of the full length


def recordings(plant: DrawnPlant, quick: bool = False, draw: int = 1) -> tuple[Trial, ...]:
    """Trials of three minutes in total at the device's rate, each from the rest after a reset.

    Steps and ramps with holds, one long hold, slow, middling and fast sines, and reversals at random; others by another
    number of the draw.
    """
    limits, share = plant.device.limits, _QUICK if quick else 1.0
    random = np.random.default_rng([plant.device.seed, draw])
    return tuple(
        _recorded(plant.reseeded(int(random.integers(2**31))), motion, name)
        for name, motion in identification_motions(limits.upper, limits.rate, random, share)
    )


def _recorded(plant: DrawnPlant, motion: Trajectory, name: str) -> Trial:
    """Command within its rate limit and the angle at the end of its sample, with a final return to rest."""
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
    """Point to point with holds, a scan and a fast scan, over random ranges within the reachable angles."""
    random = np.random.default_rng([plant.device.seed, 2])
    speed = reference_speed(plant)
    moves, scan_s = (1, 0.0) if quick else (5, 10.0)
    return drawn_motions(random, plant.true_angle, plant.reachable_deg, speed, SCANS_HZ, moves=moves, scan_s=scan_s)


def reference_speed(plant: DrawnPlant) -> float:
    """Greatest speed of fast references: a share of the mean slope times the command's greatest rate [deg/s]."""
    low, high = plant.reachable_deg
    limits = plant.device.limits
    return _SLOPE_SHARE * (high - low) / limits.upper * limits.rate
