"""One implicit step of the rod device: a semi-smooth Newton iteration over stick and slip, with shooting as its net.

Unknown are the tendon's displacements s_1..s_m at the contacts; with ds_j the change in this step and

    F+_j = T_{j-1} - exp(mu phi_j) T_j - h_j   (<= 0: whether it may slip towards the drive)
    F-_j = T_j - exp(mu phi_j) T_{j-1} - h_j   (<= 0: towards the tip)

the set-valued friction law is one equation a contact, for any rho > 0 [mm/N] (here that of the stiffer neighbour, else
the choice of stick or slip overshoots):

    ds_j = max(0, ds_j + rho F+_j) + min(0, ds_j - rho F-_j)

It is piecewise smooth, F+ rises with both neighbours' displacements and falls with its own (F- the other way round), so
the Newton matrix is tridiagonal with a dominant diagonal (Facchinei and Pang, 2003, ch. 7). Three to six iterations are
usual; where it circles, at the edge of slack or after jumps, `rod_equations.shoot` solves the same law by roots of
scalars.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

from .rod_equations import Knots, RodNumbers, StepNumbers, gravity, grip, shoot, span

TOLERANCE_MM = 1e-9
"""Greatest residual of the friction law that a step may leave [mm]."""

_NEWTON = 20  # iterations before it is given up
_GRAVITY_ROUNDS = 100
_GRAVITY_MM = 1e-10


class Work(NamedTuple):
    """Arrays of one step, by contact or span 0..m (+1); all are overwritten."""

    before: Any  # (m + 2,) displacements at the step's begin
    tension: Any  # (m + 1,)
    bend: Any  # (m + 1,), 0 in the shaft
    load: Any  # (m + 1,) moment of gravity and memory
    slope: Any  # (m + 1,) dT/dstretch
    give: Any  # (m + 1,) dq/dstretch
    upper: Any  # (m + 1,) of the tridiagonal system, eliminated
    right: Any  # (m + 1,)
    side: Any  # (m + 1,) before and after: 1 where the contact slips towards the drive, -1 to the tip, 2 freely
    reached: Any  # (m + 1,) greatest bends before the step


def new_work(contacts: int) -> Work:
    """Arrays for that many contacts."""
    return Work(np.zeros(contacts + 2), *(np.zeros(contacts + 1) for _ in range(9)))


@njit(cache=True, error_model="numpy")
def _spans(s: Any, w: Work, p: RodNumbers, d: StepNumbers) -> None:
    for j in range(w.tension.size):
        w.tension[j], w.bend[j], w.slope[j], w.give[j] = span(s[j] - s[j + 1], w.load[j], w.reached[j], j, p, d)


@njit(cache=True, error_model="numpy", inline="always")
def _sides(j: int, w: Work, p: RodNumbers) -> Any:
    """exp(mu phi), F+ and F- of contact j."""
    a = grip(j, w.bend[j], p)
    behind, ahead = w.tension[j - 1], w.tension[j]
    return a, behind - a * ahead - p.drag[j], ahead - a * behind - p.drag[j]


@njit(cache=True, error_model="numpy")
def _newton(s: Any, w: Work, p: RodNumbers, guess: float, hold: float, room: float) -> float:
    """One Newton step of s (m + 2,), none if the residual is within tolerance; returns the residual before it [mm]."""
    m = w.tension.size - 1
    worst, last_upper, last_right = 0.0, 0.0, 0.0
    for j in range(1, m + 1):  # rows lower x_{j-1} + middle x_j + upper x_{j+1} = right, eliminated on the way
        a, forward, backward = _sides(j, w, p)
        rho, moved = 0.5 * min(p.compliance[j - 1], p.compliance[j]), s[j] - w.before[j]
        steep = p.mu * a * w.give[j] * (1.0 if w.bend[j] > 0 else -1.0) if j > p.shaft_contacts else 0.0
        slack = w.slope[j - 1] + w.slope[j] == 0
        goes_on = guess * w.side[j]  # the first guess: who slipped before does so again
        free = forward == -backward  # no friction at all: the tensions are equal, whichever way it slips
        if (free or moved + rho * forward > 0 or goes_on > 0) and not slack:
            w.side[j] = 2.0 if free else 1.0
            ahead = a * w.slope[j] + steep * w.tension[j]
            worst = max(worst, abs(rho * forward))
            lower, middle, upper, right = -w.slope[j - 1], w.slope[j - 1] + ahead, -ahead, forward
        elif (moved - rho * backward < 0 or goes_on < 0) and not slack:
            w.side[j] = -1.0
            ahead = w.slope[j] - steep * w.tension[j - 1]
            worst = max(worst, abs(rho * backward))
            lower, middle, upper, right = -a * w.slope[j - 1], a * w.slope[j - 1] + ahead, -ahead, -backward
        else:
            w.side[j] = 0.0
            worst = max(worst, abs(moved))
            lower, middle, upper, right = 0.0, 1.0, 0.0, -moved
        if w.slope[j - 1] * w.slope[j] == 0:
            middle += hold / p.compliance[j]  # a taut piece between slack ones floats: the matrix would be singular
        middle -= lower * last_upper
        last_upper, last_right = upper / middle, (right - lower * last_right) / middle
        w.upper[j], w.right[j] = last_upper, last_right
    if worst <= TOLERANCE_MM:
        return worst
    step, pull = 0.0, s[0] - w.before[0]
    low, high = min(pull, 0.0) - room, max(pull, 0.0) + room
    for j in range(m, 0, -1):
        step = w.right[j] - w.upper[j] * step
        # A slip does not end beyond where it began, and does not outrun the drive by much at first.
        moved = min(max(s[j] + step - w.before[j], low), high)
        if w.side[j] < 2:
            moved = max(moved, 0.0) if w.side[j] > 0 else min(moved, 0.0) if w.side[j] < 0 else 0.0
        s[j] = w.before[j] + moved
    return worst


@njit(cache=True, error_model="numpy")
def _residual(s: Any, w: Work, p: RodNumbers) -> float:
    """Greatest residual of the friction law at s (m + 2,) and the tensions in `w` [mm]."""
    worst = 0.0
    for j in range(1, w.tension.size):
        _, forward, backward = _sides(j, w, p)
        rho, moved = 0.5 * min(p.compliance[j - 1], p.compliance[j]), s[j] - w.before[j]
        worst = max(worst, abs(moved - max(0.0, moved + rho * forward) - min(0.0, moved - rho * backward)))
    return worst


@njit(cache=True, error_model="numpy")
def solve(place: float, s: Any, w: Work, k: Knots, p: RodNumbers, d: StepNumbers) -> float:
    """Displacements s (m + 2,) after the drive has gone to `place`; returns the residual left [mm].

    `w` holds begin and loads, and afterwards tensions and bends; its `side` is what slipped last.
    """
    s[:] = w.before
    s[0] = place
    guess, hold, room = 1.0, 1.0, 0.1 * abs(place - w.before[0]) + 1e-3
    for _ in range(_NEWTON):
        _spans(s, w, p, d)
        residual = _newton(s, w, p, guess, hold, room)
        if residual <= TOLERANCE_MM and np.isfinite(s.sum()):
            return residual
        guess, hold, room = 0.0, 0.4 * hold, min(2 * room, 1e3)
    shoot(place, s, w, k, p, d)
    _spans(s, w, p, d)
    return _residual(s, w, p)


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
