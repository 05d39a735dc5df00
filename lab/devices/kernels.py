"""Compiled recursions of the drawn devices: cores, one sample, roll-outs, and a loop under PID for its tuning.

A core has functions of its own. The others take a whole device as `Packed` and its state (S,) as [commands (Q,), drive,
its speed, creep, last place of the core, state of the core], and move the state on in place.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

from . import rod_solver
from .muscle import MuscleNumbers, slack
from .muscle import advance as advance_muscle
from .rod_solver import Knots, RodNumbers, StepNumbers, Work

CAPSTAN, DAHL, ROD, MUSCLE = range(4)
FINE_S = 0.002
OWN = 4  # entries of the state beside the commands and the core's
SETTLE = 5  # fine steps in which the muscle's valve settles
_SOLVES = 30
MUSCLE_PARTS = 2
"""Steps of a muscle in a fine step, whose valve takes 2 ms."""


@njit(cache=True, error_model="numpy")
def capstan(x: Any, wrap: Any, tension: Any, shares: Any, weights: Any, rest: float, out: Any) -> None:
    """Bend out (T,) of a catheter with the tendon's proximal end at x (T,); `tension` (N,) is the state.

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
    """Angle out (T,) [deg] of a muscle under pressures x (T,) [bar]; updates `state` (5,).

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


class Packed(NamedTuple):
    """Device in the form of the recursions; parameters without use for its core have neutral values."""

    core: int
    fine: int  # fine steps in a sample
    commands: int  # Q, commands that are kept
    delay: int  # fine steps
    lag_share: float  # share of the travel to the command in a fine step, 1 without a lag
    frequency: float  # of a second-order servo [rad/s], 0 for none
    damping: float
    creep: float  # final over instant response, minus 1
    creep_share: float  # share of the creep in a fine step
    gain: float  # [deg/mm], 1 for the muscle
    offset_deg: float
    wrap: Any  # capstan: (fine,)
    pretension: float
    shares: Any
    weights: Any
    widths: Any  # Dahl elements
    parts: Any
    ones: Any  # (fine + 1,)
    muscle: MuscleNumbers
    rod: RodNumbers
    step: StepNumbers  # of the rod
    places: int  # steps of the rod in a sample
    work: Work
    knots: Knots


@njit(cache=True, error_model="numpy")
def drive(p: Packed, state: Any, u: float, places: Any) -> None:
    """Inputs of the core (fine + 1,) over one sample under the command u; the first is the last one before it.

    Delay; lag x' = (u - x) / tau, exact, or servo x'' = w^2 (u - x) - 2 zeta w x', semi-implicit; then one Kelvin-Voigt
    element, z' = (x - z) / tau, place = x + creep z.
    """
    q = p.commands
    for k in range(q - 1):
        state[k] = state[k + 1]
    state[q - 1] = u
    x, v, z = state[q], state[q + 1], state[q + 2]
    places[0] = state[q + 3]
    for j in range(p.fine):
        late = (p.delay - j + p.fine - 1) // p.fine if p.delay > j else 0
        sent = state[q - 1 - late]
        if p.frequency > 0.0:
            w = p.frequency * FINE_S
            v = (v + p.frequency * w * (sent - x)) / (1.0 + 2.0 * p.damping * w + w * w)
            x += FINE_S * v
        else:
            x += p.lag_share * (sent - x)
        z += p.creep_share * (x - z)
        places[j + 1] = x + p.creep * z
    state[q], state[q + 1], state[q + 2], state[q + 3] = x, v, z, places[p.fine]


@njit(cache=True, error_model="numpy")
def bend(p: Packed, core: Any, places: Any, steps: int) -> float:
    """Angle after inputs of the core (n + 1,), starting at its present one [deg]; updates `core`.

    Args:
        steps: in which a rod goes there.
    """
    n = places.size - 1
    out = np.empty(n + 1)
    if p.core == CAPSTAN:
        capstan(places[1:], p.wrap, core, p.shares, p.weights, p.pretension, out)
        return float(p.offset_deg + p.gain * out[n - 1])
    if p.core == DAHL:
        dahl(places, p.ones, p.widths, p.parts, core, out)
        return float(p.offset_deg + p.gain * (places[n] - out[n]))
    if p.core == MUSCLE:
        pressure = np.empty(n)
        advance_muscle(core, places[1:], p.muscle, FINE_S, MUSCLE_PARTS, out, pressure)
        return float(p.offset_deg + p.gain * out[n - 1])
    coarse, unused, tension = np.empty(steps), np.empty(steps), np.empty(steps)
    for k in range(steps):
        coarse[k] = places[n * (k + 1) // steps]
    rod_solver.advance(core, coarse, p.rod, p.step, 1, p.work, p.knots, out, unused, tension)
    return p.offset_deg + p.gain * np.radians(out[steps - 1]) * p.rod.offset


@njit(cache=True, error_model="numpy")
def advance(p: Packed, state: Any, u: float) -> float:
    """True angle at the end of one sample under the command u [deg]."""
    places = np.empty(p.fine + 1)
    drive(p, state, u, places)
    return bend(p, state[p.commands + OWN :], places, p.places)


@njit(cache=True, error_model="numpy")
def run(p: Packed, state: Any, commands: Any, theta: Any) -> None:
    """True angles theta (T,) under commands (T,)."""
    for k in range(commands.size):
        theta[k] = advance(p, state, commands[k])


@njit(cache=True, error_model="numpy")
def rollout(p: Packed, state: Any, plans: Any, theta: Any) -> None:
    """Angles (N, H) of plans (N, H) from one state, which does not change."""
    for n in range(plans.shape[0]):
        run(p, state.copy(), plans[n], theta[n])


@njit(cache=True, error_model="numpy")
def linearise(p: Packed, state: Any, plan: Any, small: float, blocks: int, theta: Any, jacobian: Any) -> None:
    """Angles (H,) along a plan (H,) and their differences over `small` by commands (H, H), `blocks` columns at once."""
    horizon = plan.size
    states, moved, other = np.empty((horizon, state.size)), np.empty(horizon), state.copy()
    for k in range(horizon):
        states[k] = other
        theta[k] = advance(p, other, plan[k])
    jacobian[:] = 0.0
    count = min(blocks, horizon)
    for b in range(count):
        start, stop = horizon * b // count, horizon * (b + 1) // count
        moved[:] = plan
        moved[start:stop] += small
        other[:] = states[start]
        for k in range(start, horizon):
            change = (advance(p, other, moved[k]) - theta[k]) / small
            sharing = min(k + 1, stop) - start
            jacobian[k, start : start + sharing] = change / sharing


@njit(cache=True, error_model="numpy")
def place_for(p: Packed, state: Any, theta: float, low: float, high: float) -> float:
    """Input of the core within [low, high] at which a straight move from the present one gives `theta`."""
    q = p.commands
    places, first = np.empty(SETTLE + 1), state[q + 3]
    places[0] = first
    ends, errors = (low, high), np.empty(2)
    for k in range(2):
        places[1:] = ends[k]
        errors[k] = bend(p, state[q + OWN :].copy(), places, 1) - theta
    if errors[0] >= 0.0:
        return low
    if errors[1] <= 0.0:
        return high
    x = first
    for _ in range(12):
        places[1:] = x
        error = bend(p, state[q + OWN :].copy(), places, 1) - theta
        if abs(error) < 1e-3:
            break
        # Illinois: the end that stays counts half, so that it does not stay for ever.
        if error > 0.0:
            high, errors[1], errors[0] = x, error, 0.5 * errors[0]
        else:
            low, errors[0], errors[1] = x, error, 0.5 * errors[1]
        x = (low * errors[1] - high * errors[0]) / (errors[1] - errors[0])
    return x


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


@njit(cache=True, error_model="numpy")
def pid_square_error(
    p: Packed, rest: Any, wanted: Any, due: Any, feedforward: Any, noise: Any, first: int, g: PidNumbers, angle: float
) -> float:
    """Mean square true error from sample `first` on under `ctrl.feedback.Pid`, in one compiled call [deg^2].

    A search takes some hundred such runs; a test holds it against the controller itself.

    Args:
        rest: state that the device rests in, at the command g.lower.
        wanted: reference at the ends of the samples (N,) [deg].
        due: what the measurement at each sample's begin is compared with (N,) [deg]; NaN for the first measurement.
        feedforward: added to the feedback (N,).
        noise: of the measurements (N + 1,) [deg].
        angle: true angle at rest [deg].
    """
    state, u, integral, speed = rest.copy(), g.lower, 0.0, 0.0
    y = angle + noise[0]
    before, smooth, span, total = y, g.dt / (g.filter_s + g.dt), g.upper - g.lower, 0.0
    for k in range(wanted.size):
        error = due[k] - y if due[k] == due[k] else 0.0
        speed += smooth * ((y - before) / g.dt - speed)
        before = y
        asked = feedforward[k] + g.kp * error + integral - g.kd * speed
        low, high = max(g.lower, u - g.reach), min(g.upper, u + g.reach)
        u = min(max(asked, low), high)
        held = error if abs(error) > g.dead_zone_deg else 0.0
        integral += g.dt * (g.ki * held + (u - asked) / g.tracking_s)
        integral = min(max(integral, -span), span)
        angle = advance(p, state, u)
        y = angle + noise[k + 1]
        if k >= first:
            total += (angle - wanted[k]) ** 2
    return total / (wanted.size - first)
