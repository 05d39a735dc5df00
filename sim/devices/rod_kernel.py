"""Compiled time loop of the rod device; equations in `rod_equations`, one step in `rod_solver`."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystmpc.models.kernels.numba_ import njit

from .rod_equations import RodNumbers, StepNumbers, gravity
from .rod_shooting import Knots
from .rod_solver import Work, solve

_GRAVITY_ROUNDS = 100
_GRAVITY_MM = 1e-10


@njit(cache=True, error_model="numpy")
def _loads(bends: Any, late: Any, moments: Any, w: Work, p: RodNumbers, d: StepNumbers) -> None:
    """Set what bends the segments besides the tendon: gravity, and what the Maxwell branches remember.

    `bends` (n,) and `late` (2, n) are those at the step's begin, `moments` (n,) of gravity.
    """
    for i in range(p.segments):
        load = moments[i]
        for b in range(2):
            load += p.branch_stiffness[b] * (d.keep[b] * late[b, i] + d.old[b] * bends[i])
        w.load[p.shaft_contacts + 1 + i] = load


@njit(cache=True, error_model="numpy")
def _step(
    place: float, s: Any, bends: Any, late: Any, moments: Any, w: Work, k: Knots, p: RodNumbers, d: StepNumbers
) -> float:
    """One step of displacements, bends (n,) and branches (2, n), the drive going to `place`. Returns the residual."""
    first = p.shaft_contacts + 1
    w.before[:] = s
    _loads(bends, late, moments, w, p, d)
    residual = solve(place, s, w, k, p, d)
    if p.weight > 0:
        for _ in range(_GRAVITY_ROUNDS):  # a contraction: `RodParameters` bounds weight over stiffness
            change = 0.0
            before = w.bend[first:].copy()
            gravity(before, moments, p)
            _loads(bends, late, moments, w, p, d)
            residual = solve(place, s, w, k, p, d)
            for i in range(p.segments):
                change = max(change, p.offset * abs(w.bend[first + i] - before[i]))
            if change <= _GRAVITY_MM:
                break
    for i in range(p.segments):
        bend = w.bend[first + i]
        for b in range(2):
            late[b, i] = d.keep[b] * late[b, i] + d.old[b] * bends[i] + d.new[b] * bend
        bends[i] = bend
        w.reached[first + i] = max(w.reached[first + i], bend)
    return residual


@njit(cache=True, error_model="numpy")
def advance(
    state: Any,
    commands: Any,
    p: RodNumbers,
    d: StepNumbers,
    parts: int,
    w: Work,
    knots: Knots,
    angle: Any,
    drive: Any,
    tension: Any,
) -> float:
    """Move `state` on through commands (T,), each in `parts` steps; outputs (T,). Returns the greatest residual [mm].

    State (1 + 2 m + 4 n,): drive, displacements at the contacts [mm], which way they slipped last (1, -1, or 0), bends,
    two branches, greatest bends [rad].
    """
    n, contacts = p.segments, w.tension.size - 1
    s = np.zeros(contacts + 2)
    x = state[0]
    s[0] = x + p.pretension
    s[1:-1] = state[1 : 1 + contacts]
    w.side[1:] = state[1 + contacts : 1 + 2 * contacts]
    rest = state[1 + 2 * contacts :]
    bends, late, moments = rest[:n].copy(), rest[n : 3 * n].copy().reshape(2, n), np.zeros(n)
    w.reached[contacts + 1 - n :] = rest[3 * n :]
    if p.weight > 0:
        gravity(bends, moments, p)
    worst = 0.0
    for k in range(commands.size):
        for _ in range(parts):
            x += d.drive_share * (commands[k] - x)
            worst = max(worst, _step(x + p.pretension, s, bends, late, moments, w, knots, p, d))
        angle[k], drive[k], tension[k] = np.degrees(bends.sum()), x, w.tension[0]
    state[0] = x
    state[1 : 1 + contacts] = s[1:-1]
    state[1 + contacts : 1 + 2 * contacts] = w.side[1:]
    rest[:n] = bends
    rest[n : 3 * n] = late.ravel()
    rest[3 * n :] = w.reached[contacts + 1 - n :]
    return worst
