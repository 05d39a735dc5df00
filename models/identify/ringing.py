"""Devices that ring: resonance and damping read off the trials, and where fits of such a device start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.trial import Trial

from ..operators.operator import Operator
from ..operators.oscillator import Oscillator, StateNetwork

_SEGMENTS = 16  # of the longest trial, over which spectra are averaged
_SEEN = 1e-3  # of the greatest power: an input of less says nothing of the response
_SLOWEST, _FASTEST = 4.0, 1.2  # cycles in a trial, and radians a sample
_LEAST_DAMPED, _MOST_DAMPED = 0.005, 0.7
_RINGING, _LONGEST = 8.0, 0.2  # time constants that a start rings, and share of the shortest trial
_HIDDEN, _ORDER = 12, 3
_VISCOUS = 0.25  # of the width of the peak; the loops of the hysteretic force take the rest
_BENT = 1e-3  # of the output: how much a neuron bends the linear system at the start


@dataclass(frozen=True)
class Ringing:
    """The resonance of a device.

    Attributes:
        rad_per_s: angular frequency of the greatest response [rad/s].
        damping: ratio to the critical damping, from the width of the peak.
        stiffness: that of a linear oscillator with this peak [cmd/deg].
        dt_s: sample time [s].
        command, angle: standard deviations of the signals [cmd], [deg].
        lead_s: time in which the ringing of an unknown start fades [s].
    """

    rad_per_s: float
    damping: float
    stiffness: float
    dt_s: float
    command: float
    angle: float
    lead_s: float

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> Ringing:
        """From the averaged spectra of the trials.

        H(f) = S_uy(f) / S_uu(f) where the command has power; a linear oscillator has its peak 1 / (2 d k) near w, and
        half the power of it at w (1 -+ d).
        """
        from scipy.signal import csd, welch  # half a second to import

        dt = trials[0].dt
        length = max(max(len(trial) for trial in trials) // _SEGMENTS, 16)
        pairs = [(trial.command - trial.command.mean(), trial.angle - trial.angle.mean()) for trial in trials]
        options = {"fs": 1 / dt, "nperseg": length}
        inside = [(u, y) for u, y in pairs if u.size >= length]
        frequency = welch(inside[0][0], **options)[0]
        power = np.sum([welch(u, **options)[1] for u, _ in inside], axis=0)
        cross = np.sum([csd(u, y, **options)[1] for u, y in inside], axis=0)
        w = 2 * math.pi * frequency
        slowest = _SLOWEST * 2 * math.pi / (max(len(trial) for trial in trials) * dt)
        usable = np.flatnonzero((power > _SEEN * power.max()) & (w >= slowest) & (w * dt <= _FASTEST))
        response = np.abs(cross[usable]) / power[usable] if usable.size else np.ones(1)
        peak = int(np.argmax(response))
        at = float(w[usable[peak]]) if usable.size else slowest
        below = np.flatnonzero(response < response[peak] / math.sqrt(2))
        ends = (below[below < peak].max(initial=0), below[below > peak].min(initial=response.size - 1))
        wide = float(np.ptp(w[usable[list(ends)]])) if usable.size else 0.0
        damping = float(np.clip(0.5 * wide / at, _LEAST_DAMPED, _MOST_DAMPED))
        ringing = min(_RINGING / (_VISCOUS * damping * at), _LONGEST * min(trial.duration_s for trial in trials))
        command, angle = (float(np.std(np.concatenate(signals))) for signals in zip(*pairs, strict=True))
        return cls(at, damping, 0.5 / (damping * float(response[peak])), dt, command, angle, ringing)


def oscillator_starts(ringing: Ringing) -> list[Operator]:
    """The linear oscillator of the peak, part of its stiffness with memory that relaxes within the range or sooner."""
    mass, damping, stiffness = _linear(ringing)
    return [
        Oscillator(mass, damping, (1 - share) * stiffness, share * stiffness, relaxing, -0.5 * relaxing)
        for relaxing in (0.5 / ringing.angle, 1.5 / ringing.angle)
        for share in (0.3, 0.6)
    ]


def _linear(ringing: Ringing) -> tuple[float, float, float]:
    """Mass, damping and stiffness of the linear oscillator with this peak; a quarter of its width is damping proper."""
    w, stiffness = ringing.rad_per_s, ringing.stiffness
    return stiffness / w**2, 2 * _VISCOUS * ringing.damping * stiffness / w, stiffness


def oscillator_box(ringing: Ringing) -> dict[str, tuple[float, float]]:
    """Half to twice the linear oscillator, any share with memory, which relaxes within the range or not at all."""
    mass, stiffness = ringing.stiffness / ringing.rad_per_s**2, ringing.stiffness
    return {
        "mass": (0.5 * mass, 2 * mass),
        "damping": (
            0.1 * ringing.damping * stiffness / ringing.rad_per_s,
            4 * ringing.damping * stiffness / ringing.rad_per_s,
        ),
        "stiffness": (0.2 * stiffness, 1.2 * stiffness),
        "alpha": (0.0, 0.8 * stiffness),
        "gamma": (0.0, 10 / ringing.angle),
        "delta": (-5 / ringing.angle, 5 / ringing.angle),
    }


def state_network_starts(ringing: Ringing, hidden: int = _HIDDEN) -> list[Operator]:
    """The turning pair of the resonance and slower states; neurons at random that bend it by a thousandth."""
    rng, n = np.random.default_rng(0), _ORDER
    left = math.exp(-ringing.damping * ringing.rad_per_s * ringing.dt_s)
    turn = ringing.rad_per_s * ringing.dt_s * math.sqrt(1 - ringing.damping**2)
    a = 0.9 * np.eye(n)
    a[:2, :2] = left * np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    a[2, 1], a[:2, 2] = 0.1, -0.02
    b = np.zeros((n, 2))
    b[1, 0] = turn / ringing.stiffness  # w^2 u / k, summed over a sample, of the second state, y' / w
    w = rng.normal(0.0, _BENT * ringing.angle, (n, hidden))
    vx, vu = rng.normal(0.0, 0.7 / ringing.angle, (hidden, n)), rng.normal(0.0, 0.7 / ringing.command, (hidden, 2))
    c = rng.normal(0.0, 0.7, hidden)
    values = np.concatenate([matrix.ravel() for matrix in (a, b, w, vx, vu, c)])
    return [StateNetwork.template(order=n, hidden=hidden).with_values(values.tolist())]


def state_network_box(ringing: Ringing) -> dict[str, tuple[float, float]]:
    """Any stable system and neurons that see the whole range."""
    gain = 1 / ringing.stiffness
    return {
        "a": (-0.3, 0.3),
        "b": (-gain, gain),
        "w": (-ringing.angle, ringing.angle),
        "vx": (-1 / ringing.angle, 1 / ringing.angle),
        "vu": (-1 / ringing.command, 1 / ringing.command),
        "c": (-1.0, 1.0),
    }
