"""Effects that no class of the library names: a right diagnosis of them is `unknown`."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.types import Vec

from . import kernels
from .generator import Generator, Shape, between
from .scene import FINE_S, Scene


def orientation_friction(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction that follows the unlogged, slowly changing roll of the shaft: 1 + `size` (1 + sin(roll)) / 2."""
    t = np.arange(u.size) * FINE_S
    random = scene.random("orientation_friction")
    roll = 2 * np.pi * (t / shape["turn_s"] + random.uniform()) + 1.5 * np.sin(2 * np.pi * t / 23.0)
    return 1 + size * (1 + np.sin(roll)) / 2


def telegraph_gain(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Gain that jumps between two values at random times (a lead that slips in its grip); `size` is the jump."""
    random = scene.random("telegraph_gain")
    flips = random.random(angle.size) < FINE_S / shape["dwell_s"]
    high = (np.cumsum(flips) + int(random.integers(2))) % 2
    return angle + size * (high - 0.5) * scene.span_deg * scene.unit(angle)


def cross_talk(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """A second tendon, moved by somebody and not logged, bends the tip by up to `size` [deg]."""
    random = scene.random("cross_talk")
    seconds = angle.size * FINE_S
    at = np.sort(random.uniform(0, seconds, max(int(seconds / shape["pause_s"]), 2)))
    level = random.uniform(-1, 1, at.size + 1)
    t = np.arange(angle.size) * FINE_S
    moved = np.empty(t.size)
    kernels.second_order(level[np.searchsorted(at, t)], FINE_S, 9.0, 1.0, moved)
    return angle + size * moved * (1 + 0.5 * scene.unit(angle))


def tip_resonance(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Lightly damped tip that rings after every acceleration: theta + `size` (ringing - theta)."""
    del scene
    out = np.empty(angle.size)
    kernels.second_order(angle, FINE_S, 2 * np.pi * shape["frequency_hz"], shape["damping"], out)
    return angle + size * (out - angle)


FOREIGN_EFFECTS = (
    Generator(
        "orientation_friction", "unknown", "friction", 1.0, 20.0, between(turn_s=(7.0, 19.0)), orientation_friction
    ),
    Generator("telegraph_gain", "unknown", "tip", 0.05, 1.0, between(dwell_s=(3.0, 9.0)), telegraph_gain),
    Generator("cross_talk", "unknown", "tip", 2.0, 30.0, between(pause_s=(3.0, 8.0)), cross_talk),
    Generator(
        "tip_resonance",
        "unknown",
        "tip",
        0.5,
        20.0,
        between(frequency_hz=(1.2, 2.5), damping=(0.02, 0.06)),
        tip_resonance,
    ),
)
