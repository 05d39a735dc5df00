"""Commands of known kinds, and the trials of a backlash that follows them."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .contenders import angle, play

DT = 0.04
WIDTH = 0.6  # of the loop of `contenders.angle` along the command [mm]


def through(*points: tuple[float, float]) -> Vec:
    """Straight lines through (time [s], level [mm]), sampled every `DT`."""
    times, levels = zip(*points, strict=True)
    return np.interp(np.arange(round(times[-1] / DT) + 1) * DT, times, levels)


def sine(hz: float = 0.2, seconds: float = 30.0, decay: float = 0.0) -> Vec:
    """A sine from zero."""
    t = np.arange(round(seconds / DT) + 1) * DT
    return np.exp(-decay * t) * 2.5 * (1 - np.cos(2 * np.pi * hz * t))


def multisine() -> Vec:
    """Four sines of no common period."""
    t = np.arange(1000) * DT
    parts = [np.sin(2 * np.pi * f * t + k) for k, f in enumerate((0.11, 0.27, 0.41, 0.58))]
    return 2.5 + 0.6 * np.sum(parts, axis=0)


def moves(levels: list[float], move_s: float, rest_s: float, smooth: bool = False) -> Vec:
    """Moves of equal time to levels, a rest after each."""
    progress = np.linspace(0, 1, round(move_s / DT) + 1)[1:]
    shape = progress**3 * (10 - 15 * progress + 6 * progress**2) if smooth else progress
    command = [0.0]
    for level in levels:
        command += (command[-1] + (level - command[-1]) * shape).tolist()
        command += [level] * round(rest_s / DT)
    return np.array(command)


LEVELS = [3.0, 1.0, 4.0, 2.0, 5.0, 0.5, 2.5, 0.0]
TRIANGLE = through(*((k * 2.0, 5.0 * (k % 2)) for k in range(11)))
THREE_SPEEDS = through((0, 0), (1, 5), (2, 0), (5, 5), (8, 0), (18, 5), (28, 0))
KINDS = {
    "sine": [sine(), sine(0.5, 14.0, 0.1)],
    "sines": [multisine()],
    "holds": [moves(LEVELS, 1.0, 5.0), through((0, 0), (2, 5), (40, 5))],
    "steps": [moves(LEVELS, 0.08, 2.0)],
    "point_to_point": [moves(LEVELS, 1.2, 1.0, smooth=True)],
    "scan": [TRIANGLE],
    "ramps": [THREE_SPEEDS],
    "mixed": [np.concatenate([moves(LEVELS, 1.0, 2.0), sine(0.5, 12.0)])],
}


def trial(command: Vec, extra: Vec | float = 0.0, name: str = "log.csv") -> Trial:
    """A backlash of 10 deg/mm that follows the command, and something besides."""
    return Trial(np.arange(command.size) * DT, command, angle(command) + extra, source=name)


__all__ = ["DT", "KINDS", "LEVELS", "THREE_SPEEDS", "TRIANGLE", "WIDTH", "moves", "multisine", "play", "sine", "trial"]
