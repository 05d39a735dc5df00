"""Withheld effects between the command and the friction: servo, transport, slack, viscous friction, tendon creep."""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from hystmpc.trials.types import Vec

from . import kernels
from .generator import Generator, Shape, between
from .scene import FINE_S, PARTS, Scene, rise

_SPEED_S = 0.03


def servo(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Servo of a position over a velocity loop, limited in speed, that stays behind a ramp by `size` [s]."""
    out = np.empty(u.size)
    kernels.cascade(u, FINE_S, size, shape["inner"], shape["strokes_per_s"] * scene.travel, out)
    return out


def jittered_delay(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Packets at the sample rate, each late by `size` (1 + jitter |n|) [s] and never before the one ahead of it."""
    sent = np.arange(0, u.size, PARTS)
    random = scene.random("jittered_delay")
    late = size * (1 + shape["jitter"] * np.abs(random.standard_normal(sent.size)))
    arrival = np.maximum.accumulate(sent * FINE_S + late)
    return np.interp(np.arange(u.size) * FINE_S, arrival, u[sent])


def fibre_toe(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Fibres that are recruited one after another: x = u - L (1 - exp(-u / L)) with L = `size` [mm]."""
    del scene, shape
    return u - size * (1 - np.exp(-np.maximum(u, 0.0) / size))


def viscous_wrap(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction factor 1 + `size` (|v| / v0)^a with a speed v that lags by a lubricant film's 30 ms."""
    weights = np.exp(-np.arange(0, 5 * _SPEED_S, FINE_S) / _SPEED_S)
    speed = np.convolve(np.abs(rise(u)), weights / weights.sum())[: u.size]
    return 1 + size * (speed / scene.travel) ** shape["power"]


def log_relaxation(signal: Vec, share: float, onset_s: float) -> Vec:
    """Answer of a log-law solid: share * integral of ds(t') log10(1 + (t - t') / onset), the instant part left out."""
    t = np.arange(signal.size) * FINE_S
    kernel = share * np.log10(1 + t / onset_s)
    return np.asarray(fftconvolve(np.diff(signal, prepend=signal[0]), kernel)[: signal.size])


def tendon_creep(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Tendon that stretches by a logarithmic law: x = u - log_relaxation(u); `size` is the share per decade."""
    del scene
    return u - log_relaxation(u, size, shape["onset_s"])


DRIVE_EFFECTS = (
    Generator("cascaded_servo", "lag", "drive", 0.05, 1.0, between(inner=(1.2, 2.6), strokes_per_s=(3.0, 12.0)), servo),
    Generator("jittered_delay", "delay", "drive", 0.05, 1.0, between(jitter=(0.05, 0.25)), jittered_delay),
    Generator("fibre_toe", "slack", "drive", 0.3, 3.0, between(), fibre_toe),
    Generator("viscous_wrap", "rate_dependence", "friction", 1.0, 60.0, between(power=(0.7, 1.2)), viscous_wrap),
    Generator("tendon_log_creep", "creep", "drive", 0.03, 0.4, between(onset_s=(0.2, 1.0)), tendon_creep),
)
