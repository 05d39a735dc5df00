"""The basis of the learned part: what a drive and a hysteresis operator with free weights show of the command.

    theta = m + w_c (m - m_0) + sum_i w_i f_i(v),   v = lag_tau(u(t - D))

m is the model's angle, v the travel behind a drive with the lag tau and the delay D, both as shares of the command's
range. The f_i are differences from the start: v itself, plays of v (a Prandtl-Ishlinskii operator), one-sided dead
zones of v (a superposition operator; both Kuhnen, "Modeling, identification and compensation of complex hysteretic
nonlinearities", European Journal of Control 9, 2003), plays times v, slow followers of v (creep), and the rate of v,
which stands for a drive between two of the grid. All functions work on one flat state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystmpc.models.kernels.numba_ import njit
from hystmpc.trials.types import Vec

LAGS_S: Vec = np.array([0.0, 0.02, 0.045, 0.075, 0.11, 0.15, 0.2, 0.26])
DELAYS = 6
"""Delays of 0 to 5 samples."""
RADII: Vec = np.array([0.008, 0.02, 0.05, 0.1, 0.2])
ZONES: Vec = np.array([0.05, 0.1, 0.16, 0.24, 0.34, 0.46, 0.6, 0.78])
CREEPS_S: Vec = np.array([0.8, 4.0])
_WEIGHTED = 4  # plays, the widest, that also count times v
_RATE_S = 0.1  # unit of the rate of v
_EDGE = 1e-12
FEATURES = 1 + RADII.size + ZONES.size + _WEIGHTED + CREEPS_S.size + 1
MEMORY = 1 + RADII.size + CREEPS_S.size
"""Entries of the memory behind one lag: v, plays, slow followers."""
OWN = MEMORY + DELAYS + 1 + FEATURES + 5
"""Entries of the learned part's state: memory, queue of the last commands, weights, v0, side, m_0, share of the lag in
a sample, delay [samples]; commands as shares of the range, the newest first."""
OF_WEIGHTS, OF_START = slice(MEMORY + DELAYS, OWN - 5), slice(OWN - 5, OWN)
SHARES: Vec = np.concatenate(
    [[0.7], np.full(RADII.size, 0.5), np.full(ZONES.size, 1.0), np.full(_WEIGHTED, 0.5), [0.2, 0.2], [0.3]]
)
"""Standard deviations of the weights beside each other; their level is a setting."""


def basis_numbers() -> Mapping[str, float | Vec]:
    """Numbers of the basis, for the same basis in another language."""
    return {
        "memory": MEMORY,
        "weights": 1 + FEATURES,
        "delays": DELAYS,
        "plays": RADII.size,
        "zones": ZONES.size,
        "creeps": CREEPS_S.size,
        "weighted": _WEIGHTED,
        "radii": RADII,
        "zone_starts": ZONES,
        "rate_s": _RATE_S,
        "edge": _EDGE,
    }


def first_memory(v: float, side: float) -> Vec:
    """Memory (MEMORY,) of a device that rests at the travel v and has come from the side +1 (above) or -1."""
    return np.concatenate([[v], v + side * RADII, np.full(CREEPS_S.size, v)])


def lag_shares(dt: float) -> Vec:
    """Share of the way that each lag of the grid goes in a sample."""
    return np.array([1.0 if tau == 0 else -math.expm1(-dt / tau) for tau in LAGS_S])


def creep_shares(dt: float) -> Vec:
    """Share of the way that each slow follower goes in a sample."""
    return np.asarray(-np.expm1(-dt / CREEPS_S))


@njit(cache=True, error_model="numpy", nogil=True)
def advance_memory(memory: Any, x: float, share: float, creeps: Any) -> None:
    """Memory (MEMORY,) one sample later under the delayed command x, in place."""
    count = RADII.size
    memory[0] += share * (x - memory[0])
    v = memory[0]
    for i in range(count):
        memory[1 + i] = min(max(memory[1 + i], v - RADII[i]), v + RADII[i])
    for j in range(CREEPS_S.size):
        memory[1 + count + j] += creeps[j] * (v - memory[1 + count + j])


@njit(cache=True, error_model="numpy", nogil=True)
def features(memory: Any, before: float, v0: float, side: float, pace: float, out: Any) -> None:
    """Features f (FEATURES,) of a memory.

    Args:
        before: v one sample ago.
        v0, side: where the device started.
        pace: samples per second.
    """
    count, v = RADII.size, memory[0]
    out[0] = v - v0
    at = 1
    for i in range(count):
        out[at] = memory[1 + i] - v0 - side * RADII[i]
        at += 1
    for i in range(ZONES.size):
        out[at] = max(v - ZONES[i], 0.0) - max(v0 - ZONES[i], 0.0)
        at += 1
    for i in range(count - _WEIGHTED, count):
        out[at] = (memory[1 + i] - v) * v - side * RADII[i] * v0
        at += 1
    for j in range(CREEPS_S.size):
        out[at] = v - memory[1 + count + j]
        at += 1
    out[at] = (v - before) * pace * _RATE_S


@njit(cache=True, error_model="numpy", nogil=True)
def acting_command(own: Any, plan: Any, k: int, low: float, span: float) -> Any:
    """The command behind the delay in sample k of a plan (H,), as a share of the range."""
    delay = int(own[OWN - 1])
    return own[MEMORY + delay - 1 - k] if k < delay else (plan[k - delay] - low) / span


@njit(cache=True, error_model="numpy", nogil=True)
def add_learned(own: Any, pace: float, creeps: Any, low: float, span: float, plans: Any, angles: Any) -> None:
    """angles (N, H) <- m + w_c (m - m_0) + sum_i w_i f_i along plans (N, H), in place.

    Args:
        own: the learned part's state (OWN,).
        pace: samples per second.
        creeps: as `creep_shares`.
        low, span: least command, and the range of commands [command unit].
    """
    weights, start, horizon = own[OF_WEIGHTS], own[OF_START], plans.shape[1]
    now, f = np.empty(MEMORY), np.empty(FEATURES)
    for n in range(plans.shape[0]):
        now[:] = own[:MEMORY]
        for k in range(horizon):
            before = now[0]
            advance_memory(now, acting_command(own, plans[n], k, low, span), start[3], creeps)
            features(now, before, start[0], start[1], pace, f)
            total = weights[0] * (angles[n, k] - start[2])
            for i in range(FEATURES):
                total += weights[1 + i] * f[i]
            angles[n, k] += total


@njit(cache=True, error_model="numpy", nogil=True)
def advance_slopes(before: Any, now: Any, acting: int, share: float, creeps: Any, by: Any) -> None:
    """Derivatives of a memory by the commands of a plan, one sample later, in place: by (MEMORY + 1, H).

    The last row is that of v one sample ago. A play at its edge counts as driven.

    Args:
        before, now: memory before and after the sample (MEMORY,).
        acting: the command of the plan that acts in this sample; negative where none does yet.
    """
    count, v = RADII.size, now[0]
    for j in range(acting + 1):
        by[MEMORY, j] = by[0, j]
        by[0, j] *= 1.0 - share
    if acting >= 0:
        by[0, acting] = share
    for i in range(count):
        if v - RADII[i] >= before[1 + i] - _EDGE or v + RADII[i] <= before[1 + i] + _EDGE:
            for j in range(acting + 1):
                by[1 + i, j] = by[0, j]
    for c in range(CREEPS_S.size):
        for j in range(acting + 1):
            by[1 + count + c, j] += creeps[c] * (by[0, j] - by[1 + count + c, j])


@njit(cache=True, error_model="numpy", nogil=True)
def slopes_by_memory(now: Any, weights: Any, pace: float, out: Any) -> None:
    """Derivatives of sum_i w_i f_i by the memory and by v one sample ago (MEMORY + 1,)."""
    count, v = RADII.size, now[0]
    out[:] = 0.0
    out[0] = weights[1]
    for i in range(count):
        out[1 + i] = weights[2 + i]
    at = 2 + count
    for i in range(ZONES.size):
        if v > ZONES[i]:
            out[0] += weights[at + i]
    at += ZONES.size
    for i in range(_WEIGHTED):
        play = 1 + count - _WEIGHTED + i
        out[play] += weights[at + i] * v
        out[0] += weights[at + i] * (now[play] - 2.0 * v)
    at += _WEIGHTED
    for c in range(CREEPS_S.size):
        out[0] += weights[at + c]
        out[1 + count + c] -= weights[at + c]
    rate = weights[FEATURES] * pace * _RATE_S
    out[0] += rate
    out[MEMORY] -= rate


@njit(cache=True, error_model="numpy", nogil=True)
def add_slopes(own: Any, pace: float, creeps: Any, low: float, span: float, plan: Any, jacobian: Any) -> None:
    """jacobian (H, H) of the model <- that of the whole, along one plan (H,), in place; see `add_learned`."""
    weights, share, horizon = own[OF_WEIGHTS], own[OWN - 2], plan.size
    now, before, slopes = own[:MEMORY].copy(), np.empty(MEMORY), np.empty(MEMORY + 1)
    by, row = np.zeros((MEMORY + 1, horizon)), np.empty(horizon)
    for k in range(horizon):
        before[:] = now
        advance_memory(now, acting_command(own, plan, k, low, span), share, creeps)
        advance_slopes(before, now, k - int(own[OWN - 1]), share, creeps, by)
        slopes_by_memory(now, weights, pace, slopes)
        row[: k + 1] = 0.0
        for i in range(MEMORY + 1):
            for j in range(k + 1):
                row[j] += slopes[i] * by[i, j]
        for j in range(k + 1):
            jacobian[k, j] = (1.0 + weights[0]) * jacobian[k, j] + row[j] / span
