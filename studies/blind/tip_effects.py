"""Withheld effects between the friction and the sensor that act at once: stick, contact, weight, stiffness."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.types import Vec

from . import kernels
from .generator import Generator, Shape, between
from .scene import FINE_S, Scene

_LUGRE = np.array([150.0, 0.02, 0.01])  # presliding stiffness, its damping [s], viscous friction [s]


def lugre_tip(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Tip that sticks in its lumen by LuGre friction; `size` is the break-away [deg of bending]."""
    del scene
    out = np.empty(angle.size)
    kernels.lugre(angle, FINE_S, size, shape["ratio"], shape["stribeck_deg_s"], _LUGRE, out)
    return out


def hertz_contact(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Wall that pushes back by Hertz's law beyond a bend a: free = y + `size` span ((y - a) / span)^1.5."""
    free, at = scene.unit(angle), shape["at"]
    deep = np.maximum(free - at, 0.0)
    y = deep.copy()
    for _ in range(30):  # monotone and convex: Newton from above goes down to the root
        y = np.maximum(y - (y + size * y**1.5 - deep) / (1 + 1.5 * size * np.sqrt(y)), 0.0)
    return scene.rest_deg + scene.span_deg * (free - deep + y)


def weight(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Bending under its own weight: theta + `size` (sin(theta - phi) - sin(rest - phi)), phi the mounting [deg]."""
    turned, rest = (np.deg2rad(a - shape["mounting_deg"]) for a in (angle, scene.rest_deg))
    return angle + size * (np.sin(turned) - np.sin(rest))


def directional_stiffness(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Elasticity that depends on the direction: theta + `size` d p(theta), d a smoothed direction in -1..1."""
    d, bend = np.empty(angle.size), scene.unit(angle)
    kernels.direction(bend, shape["turn"], d)
    return angle + size * d * np.clip(bend, 0.0, 1.2) ** shape["power"]


TIP_EFFECTS = (
    Generator(
        "lugre_tip", "stick_slip", "tip", 2.0, 25.0, between(ratio=(0.3, 0.5), stribeck_deg_s=(5.0, 20.0)), lugre_tip
    ),
    Generator("hertz_contact", "contact", "tip", 1.0, 400.0, between(at=(0.5, 0.72)), hertz_contact),
    Generator("weight", "nonlinear_gain", "tip", 3.0, 50.0, between(mounting_deg=(-65.0, -20.0)), weight),
    Generator(
        "directional_stiffness",
        "asymmetry",
        "tip",
        2.0,
        30.0,
        between(turn=(0.02, 0.06), power=(1.6, 2.4)),
        directional_stiffness,
    ),
)
