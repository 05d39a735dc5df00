"""Recursions of the drawn devices, in C: cores, one sample, roll-outs, and a loop under PID for its tuning.

Equations and the layout of a device and of its state (S,) stand in c/friction.h, c/muscle.h and c/drawn.h. What is
called `state`, `tension` or `deflection` moves on in place where nothing else is said.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hystmpc.trials.types import Vec

from ..library import laboratory
from .muscle import MuscleNumbers

CAPSTAN, DAHL, ROD, MUSCLE = range(4)
FINE_S = 0.002
OWN = 4  # entries of the state beside the commands and the core's
SETTLE = 5  # fine steps in which the muscle's valve settles
MUSCLE_PARTS = 2
"""Steps of a muscle in a fine step, whose valve takes 2 ms."""


def capstan(
    x: Vec, wrap: float, scale: Vec, curl: float, tension: Vec, points: tuple[Vec, Vec, Vec], rest: float, out: Vec
) -> None:
    """Bend out (T,) of a catheter with the tendon's proximal end at x (T,) [mm]; `tension` (N,) [N] is the state.

    Args:
        scale: factors of wrap and drags (T,).
        points: shares, weights and drags, (N,) each.
    """
    laboratory().capstan(x, x.size, wrap, scale, 1, curl, tension, tension.size, *points, rest, out)


def dahl(x: Vec, scale: Vec, widths: Vec, shares: Vec, deflection: Vec, out: Vec) -> None:
    """Friction deflection out (T,) of parallel Dahl elements along x (T,); `deflection` (N,) is the state."""
    laboratory().dahl(x, x.size, scale, 1, widths, shares, deflection, deflection.size, out)


def muscle(x: Vec, friction: Vec, p: MuscleNumbers, dt: float, state: Vec, out: Vec) -> None:
    """Angle out (T,) [deg] of a muscle under pressures x (T,) [bar] and friction (T,) over pull; `state` (5,)."""
    laboratory().rubbing_muscle(state, x, x.size, friction, np.array(p), dt, MUSCLE_PARTS, out)


class Packed(NamedTuple):
    """Device in the form of the recursions.

    Attributes:
        sizes, numbers: as c/drawn.h says.
        states: entries S of the state.
        room: working memory without states, in numbers.
        commands: Q, commands that are kept.
        creep: final over instant response, minus 1.
    """

    sizes: Any
    numbers: Vec
    states: int
    room: int
    commands: int
    creep: float

    def work(self, states: int) -> Vec:
        """Working memory with so many states."""
        return np.empty(self.room + states * self.states)


def advance(p: Packed, state: Vec, u: float) -> float:
    """True angle at the end of one sample under the command u [deg]."""
    return float(laboratory().drawn_step(p.sizes, p.numbers, state, u, p.work(0)))


def run(p: Packed, state: Vec, commands: Vec, theta: Vec) -> None:
    """True angles theta (T,) under commands (T,)."""
    laboratory().drawn(p.sizes, p.numbers, state, commands, commands.size, theta, p.work(0))


def rollout(p: Packed, state: Vec, plans: Vec, theta: Vec) -> None:
    """Angles (N, H) of plans (N, H) from one state, which does not change."""
    laboratory().drawn_rollout(p.sizes, p.numbers, state, plans, *plans.shape, theta, p.work(1))


def linearise(p: Packed, state: Vec, plan: Vec, small: float, blocks: int, theta: Vec, jacobian: Vec) -> None:
    """Angles (H,) along a plan (H,) and their differences over `small` by commands (H, H), `blocks` columns at once."""
    work, horizon = p.work(plan.size + 1), plan.size
    laboratory().drawn_linearise(p.sizes, p.numbers, state, plan, horizon, small, blocks, theta, jacobian, work)


def place_for(p: Packed, state: Vec, theta: float, low: float, high: float) -> float:
    """Input of the core within [low, high] at which a straight move from the present one gives `theta`."""
    return float(laboratory().drawn_place(p.sizes, p.numbers, state, theta, low, high, p.work(1)))


class PidNumbers(NamedTuple):
    """Gains as `ctrl.feedback.PidSettings`, and the limits of the command with its greatest change a sample."""

    kp: float
    ki: float
    kd: float
    filter_s: float
    tracking_s: float
    dead_zone_deg: float
    lower: float
    upper: float
    reach: float
    dt: float


def pid_square_error(
    p: Packed, rest: Vec, wanted: Vec, due: Vec, feedforward: Vec, noise: Vec, first: int, g: PidNumbers, angle: float
) -> float:
    """Mean square true error from sample `first` on under `ctrl.feedback.Pid`, in one call [deg^2].

    A search takes some hundred such runs; a test holds it against the controller itself.

    Args:
        rest: state that the device rests in, at the command g.lower.
        wanted: reference at the ends of the samples (N,) [deg].
        due: what the measurement at each sample's begin is compared with (N,) [deg]; NaN for the first measurement.
        feedforward: added to the feedback (N,).
        noise: of the measurements (N + 1,) [deg].
        angle: true angle at rest [deg].
    """
    signals = wanted, due, feedforward, noise, wanted.size
    gains = np.array(g, dtype=np.float64)
    return float(laboratory().drawn_pid(p.sizes, p.numbers, rest, angle, *signals, first, gains, p.work(1)))
