"""Compiled recursions of withheld effects."""

from __future__ import annotations

import math
from typing import Any

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy")
def second_order(u: Any, dt: float, frequency: float, damping: float, out: Any) -> None:
    """x'' = w^2 (u - x) - 2 zeta w x', semi-implicit, from rest at u[0]; w in rad/s."""
    x, v = u[0], 0.0
    for k in range(u.size):
        v = (v + dt * frequency**2 * (u[k] - x)) / (1 + 2 * dt * damping * frequency + (dt * frequency) ** 2)
        x += dt * v
        out[k] = x


@njit(cache=True, error_model="numpy")
def cascade(u: Any, dt: float, lag: float, inner: float, limit: float, out: Any) -> None:
    """Position loop over a velocity loop, from rest at u[0]; stays behind a ramp by `lag` [s].

    x' = v,  v' = b (r - v) + b^2 / 4 q,  q' = r - v,  r = clip((u - x) / lag, +-limit),  b = inner / lag.
    """
    x, v, q, band = u[0], 0.0, 0.0, inner / lag
    for k in range(u.size):
        wanted = min(max((u[k] - x) / lag, -limit), limit)
        v = (v + dt * band * (wanted + 0.25 * band * q)) / (1 + dt * band)
        q += dt * (wanted - v)
        x += dt * v
        out[k] = x


@njit(cache=True, error_model="numpy")
def lugre(drive: Any, dt: float, break_away: float, ratio: float, speed: float, numbers: Any, out: Any) -> None:
    """Overdamped LuGre block behind a spring of unit stiffness; all forces are in degrees of the spring.

    drive - y = s0 z + s1 z' + s2 y',  z' = v - s0 |v| z / g(v),  g = Fs (r + (1 - r) exp(-(v / vs)^2)), v = y'
    (Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995, eq. (1)-(3)); z' is implicit.
    """
    s0, s1, s2 = numbers[0], numbers[1], numbers[2]
    y, z, v = drive[0], 0.0, 0.0
    for k in range(drive.size):
        g = break_away * (ratio + (1 - ratio) * math.exp(-((v / speed) ** 2)))
        decay = s0 * abs(v) / max(g, 1e-9)
        # Force balance at the end of the step, z and y implicit in v, the decay rate explicit.
        keep = 1 / (1 + dt * decay)
        held = s0 * keep * z - s1 * decay * keep * z
        per_v = dt + s0 * keep * dt + s1 * (1 - decay * keep * dt) + s2
        v = (drive[k] - y - held) / per_v
        z = keep * (z + dt * v)
        y += dt * v
        out[k] = y


@njit(cache=True, error_model="numpy")
def direction(x: Any, length: float, out: Any) -> None:
    """Smoothed direction d in -1..1: dd / d|x| = (sign(dx) - d) / length, from d = 0."""
    d, before = 0.0, x[0]
    for k in range(x.size):
        step = x[k] - before
        before = x[k]
        if step != 0.0:
            side = 1.0 if step > 0 else -1.0
            d = side + (d - side) * math.exp(-abs(step) / length)
        out[k] = d


@njit(cache=True, error_model="numpy")
def plastic(bend: Any, dt: float, limit: float, exponent: float, rate: float, out: Any) -> None:
    """Set s with unit hardening: s' = rate max(bend - limit - s, 0)^exponent (Norton and Hoff), which never shrinks."""
    s = 0.0
    for k in range(bend.size):
        s += dt * rate * max(bend[k] - limit - s, 0.0) ** exponent
        out[k] = s
