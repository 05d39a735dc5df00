"""Compiled recursions of the device cores and withheld effects."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hystmpc.models.kernels.numba_ import njit
from hystmpc.sim.devices.muscle import MuscleNumbers, slack
from hystmpc.sim.devices.muscle import advance as advance_muscle

_SOLVES = 30
MUSCLE_PARTS = 2
"""Steps of a muscle in a fine step, whose valve takes 2 ms."""


@njit(cache=True, error_model="numpy")
def capstan(x: Any, wrap: Any, tension: Any, shares: Any, weights: Any, rest: float, out: Any) -> None:
    """Bend out (T,) of a catheter whose tendon's proximal end is at x (T,); `tension` (N,) is the state.

    x = sum shares_i (T_i - rest) and out = sum weights_i (T_i - rest), displacements [mm] of tensions [N].

    Quasi-static: every point keeps its tension unless the proximal tension T0 pulls it out of its friction cone,
    T_i <- clip(T_i, T0 exp(-kappa s_i), T0 exp(+kappa s_i)); T0 meets the proximal displacement.
    """
    count = tension.size
    low, high, following = np.empty(count), np.empty(count), np.empty(count)
    t0 = tension[0]
    for k in range(x.size):
        for i in range(count):
            high[i] = math.exp(wrap[k] * i / (count - 1))
            low[i] = 1 / high[i]
        for _ in range(_SOLVES):
            total, slope = 0.0, 0.0
            for i in range(count):
                value, rate = tension[i], 0.0
                if value < t0 * low[i]:
                    value, rate = t0 * low[i], low[i]
                elif value > t0 * high[i]:
                    value, rate = t0 * high[i], high[i]
                elif i == 0:
                    value, rate = t0, 1.0
                total += shares[i] * (value - rest)
                slope += shares[i] * rate
                following[i] = value
            miss = x[k] - total
            if abs(miss) < 1e-9:
                break
            t0 = max(t0 + miss / max(slope, shares[0]), 1e-6)
        bend = 0.0
        for i in range(count):
            tension[i] = following[i]
            bend += weights[i] * (following[i] - rest)
        out[k] = bend


@njit(cache=True, error_model="numpy")
def dahl(x: Any, scale: Any, widths: Any, shares: Any, deflection: Any, out: Any) -> None:
    """Friction deflection out (T,) of parallel Dahl elements; `deflection` (N,) is the state.

    dd_i / d|x| = (sign(dx) w_i - d_i) / w_i, exact over a step of constant direction.
    """
    before = x[0]
    for k in range(x.size):
        step = x[k] - before
        before = x[k]
        total = 0.0
        for i in range(widths.size):
            width = widths[i] * scale[k]
            if step != 0.0:
                side = width if step > 0 else -width
                deflection[i] = side + (deflection[i] - side) * math.exp(-abs(step) / width)
            total += shares[i] * deflection[i]
        out[k] = total


@njit(cache=True, error_model="numpy")
def muscle(x: Any, friction: Any, p: Any, dt: float, state: Any, out: Any) -> None:
    """Angle out (T,) [deg] of a muscle under pressures x (T,) [bar]; `state` (5,) is moved on.

    Friction f (T,) over pull stands for that among its numbers `p`. The pull b (1 - f z) turns with z within the
    presliding: that is at least 2 f b / (1 - f), so that the pull never rises as the pressure b falls.
    """
    pressure = np.empty(1)
    for k in range(x.size):
        bladder = slack(x[k], p.slack_bar, p.slack_width_bar)
        least = 2 * friction[k] * bladder / (1 - friction[k])
        now = MuscleNumbers(
            p.supply_bar,
            p.valve_s,
            p.fill_s,
            p.vent_s,
            p.slack_bar,
            p.slack_width_bar,
            friction[k],
            max(p.presliding_bar, least),
            p.greatest_deg,
            p.half_bar,
            p.late,
            p.late_share,
            p.bend_share,
        )
        advance_muscle(state, x[k : k + 1], now, dt, MUSCLE_PARTS, out[k : k + 1], pressure)


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
