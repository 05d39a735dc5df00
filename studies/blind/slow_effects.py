"""Withheld effects of time, history and surroundings: wall creep, temperature, plastic set, trials, heartbeat."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.types import Vec

from . import kernels
from .drive_effects import log_relaxation
from .generator import Generator, Shape, between
from .scene import FINE_S, Scene

_WALK_S = 1.0
_SESSION_S = 1800.0


def wall_creep(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Wall that gives way by a logarithmic law: theta + log_relaxation(theta), `size` the share per decade."""
    del scene
    return angle + log_relaxation(angle, size, shape["onset_s"])


def thermal_drift(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Trend of `size` [deg/min] and a random walk about it over the whole session; it scales the bend or shifts it."""
    random = scene.random("thermal_drift", every_trial=False)
    walk = np.cumsum(random.standard_normal(round(_SESSION_S / _WALK_S)))
    minutes = (scene.clock_s + np.arange(angle.size) * FINE_S) / 60
    wander = np.interp(60 * minutes, np.arange(walk.size) * _WALK_S, walk) * np.sqrt(_WALK_S / 60)
    slow = size * shape["sign"] * (minutes + shape["walk"] * wander)
    return angle + slow * (1 - shape["softening"] + shape["softening"] * 2 * scene.unit(angle))


def _drift_shape(random: np.random.Generator) -> dict[str, float]:
    return {
        "sign": float(random.choice([-1, 1])),
        "walk": float(random.uniform(0.1, 0.3)),
        "softening": float(random.choice([0, 1])),
    }


def plastic_set(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Set by viscoplastic flow with hardening beyond a yield bend, about `size` [deg]; it heals between trials."""
    bend, out = np.maximum.accumulate(scene.unit(angle)), np.empty(angle.size)
    kernels.plastic(bend, FINE_S, shape["yield"], shape["exponent"], shape["rate_per_s"], out)
    return angle + size * out / max(1 - shape["yield"], 0.05)


def remounting(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Every trial has its own shift, `size` [deg] times Student's t (5 degrees), and its own gain."""
    random = scene.random("remounting")
    shift, gain = random.standard_t(5), random.standard_normal()
    return angle + size * shift + size * shape["gain"] * gain * scene.unit(angle)


def heartbeat(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Pulse wave with a dicrotic notch, `size` [deg] high, at a rate that wanders by 2 % from beat to beat."""
    random = scene.random("heartbeat")
    beats = int(angle.size * FINE_S * shape["rate_hz"] * 1.5) + 4
    ends = np.cumsum((1 + 0.02 * random.standard_normal(beats)) / shape["rate_hz"]) - random.uniform(0, 1) - 0.5
    phase = np.mod(np.interp(np.arange(angle.size) * FINE_S, ends, np.arange(beats, dtype=np.float64)), 1.0)
    pulse = np.exp(-(((phase - 0.22) / 0.09) ** 2)) + 0.35 * np.exp(-(((phase - 0.52) / 0.08) ** 2))
    return angle + size * (pulse - pulse.mean())


def breathing(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Breathing that rests at the end of expiration: `size` [deg] (1 - cos^4(pi f t)), Lujan's law."""
    phase = scene.random("breathing").uniform(0, 1)
    move = 1 - np.cos(np.pi * (shape["rate_hz"] * np.arange(angle.size) * FINE_S + phase)) ** 4
    return angle + size * (move - move.mean())


SLOW_EFFECTS = (
    Generator("wall_log_creep", "creep", "tip", 0.03, 0.4, between(onset_s=(0.2, 1.0)), wall_creep),
    Generator("thermal_drift", "drift", "tip", 0.3, 10.0, _drift_shape, thermal_drift),
    Generator(
        "plastic_set",
        "first_flexure",
        "tip",
        2.0,
        40.0,
        between(**{"yield": (0.1, 0.35), "exponent": (1.3, 2.0), "rate_per_s": (3.0, 12.0)}),
        plastic_set,
    ),
    Generator("remounting", "trial_shift", "tip", 0.6, 20.0, between(gain=(0.3, 0.8)), remounting),
    Generator("heartbeat", "periodic_disturbance", "tip", 1.0, 20.0, between(rate_hz=(0.9, 1.7)), heartbeat),
    Generator("breathing", "periodic_disturbance", "tip", 1.0, 20.0, between(rate_hz=(0.18, 0.35)), breathing),
)
