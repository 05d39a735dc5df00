"""One implicit step of the rod device: a semi-smooth Newton iteration over stick and slip, with sweeps as its net.

Unknown are the tendon's displacements s_1..s_m at the contacts; with ds_j the change in this step and

    F+_j = T_{j-1} - exp(mu phi_j) T_j - h_j   (<= 0: whether it may slip towards the drive)
    F-_j = T_j - exp(mu phi_j) T_{j-1} - h_j   (<= 0: towards the tip)

the set-valued friction law is one equation a contact, for any rho > 0 [mm/N] (here that of the stiffer neighbour, else
the choice of stick or slip overshoots):

    ds_j = max(0, ds_j + rho F+_j) + min(0, ds_j - rho F-_j)

It is piecewise smooth, F+ rises with both neighbours' displacements and falls with its own (F- the other way round), so
the Newton matrix is tridiagonal with a dominant diagonal, and sweeping from contact to contact (nonlinear Gauss-Seidel)
converges from anywhere; Newton does in few iterations what sweeps do in hundreds (Facchinei and Pang, 2003, ch. 7;
Rheinboldt, J. Math. Anal. Appl. 32, 1970, for the sweeps).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from .rod_equations import RodNumbers, StepNumbers, grip, span

TOLERANCE_MM = 1e-9
"""Greatest residual of the friction law that a step may leave [mm]."""

_NEWTON = 20  # iterations before sweeps help; three to six are usual
_ROUNDS = 6
_HALVINGS = 8
_SECANTS = 60


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
def _side_at(at: float, j: int, forward: bool, s: Any, w: Work, p: RodNumbers, d: StepNumbers) -> float:
    """F+ (or F-) of contact j if it stood at `at`."""
    s[j] = at
    for k in (j - 1, j):
        w.tension[k], w.bend[k], w.slope[k], w.give[k] = span(s[k] - s[k + 1], w.load[k], w.reached[k], k, p, d)
    _, plus, minus = _sides(j, w, p)
    return plus if forward else minus


@njit(cache=True, error_model="numpy")
def _sweep(s: Any, w: Work, p: RodNumbers, d: StepNumbers) -> None:
    """Solve each contact's own equation once, the others standing still."""
    for j in range(1, w.tension.size):
        still = w.before[j]
        forward = _side_at(still, j, True, s, w, p, d) > 0
        if not forward and _side_at(still, j, False, s, w, p, d) <= 0:
            continue
        # Where the pulling span is slack the slip has ended: this brackets the root, regula falsi (Illinois) finds it.
        near, far, reach = still, still, 1e-4 if forward else -1e-4
        above, below = _side_at(still, j, forward, s, w, p, d), 1.0
        while below > 0:
            far, reach = still + reach, 4 * reach
            below = _side_at(far, j, forward, s, w, p, d)
        for _ in range(_SECANTS):
            at = near + (far - near) * above / (above - below)
            value = _side_at(at, j, forward, s, w, p, d)
            if value > 0:
                near, above, below = at, value, 0.5 * below
            else:
                far, below, above = at, value, 0.5 * above
            if abs(value) * p.compliance[j] < 0.1 * TOLERANCE_MM:
                break


@njit(cache=True, error_model="numpy")
def _solve_at_once(s: Any, w: Work, p: RodNumbers, d: StepNumbers) -> float:
    """Displacements s (m + 2,) at the end of a step, s[0] given; returns the residual left [mm]."""
    residual, pull = np.inf, s[0] - w.before[0]
    guess, room = 1.0, 0.1 * abs(pull) + 1e-3
    for sweeps in range(_ROUNDS):
        hold = 1.0
        for _ in range(_NEWTON):
            _spans(s, w, p, d)
            residual = _newton(s, w, p, guess, hold, room)
            if residual <= TOLERANCE_MM:
                return residual
            guess, hold, room = 0.0, 0.4 * hold, min(2 * room, 1e3)
        for j in range(1, w.tension.size):
            if not np.isfinite(s[j]):
                s[j] = w.before[j]
        for _ in range(sweeps + 1):
            _sweep(s, w, p, d)
    return residual


@njit(cache=True, error_model="numpy")
def solve(place: float, s: Any, w: Work, p: RodNumbers, d: StepNumbers) -> float:
    """Displacements s (m + 2,) after the drive has gone to `place`; returns the residual left [mm].

    A way that is not solved at once is gone in 2, 4, 8, ... equal parts: friction without viscosity depends on the
    path alone, so that parts of a straight way are its more exact solution. `w` holds begin and loads, and afterwards
    tensions and bends; its `side` is what slipped last.
    """
    begin, side = w.before.copy(), w.side.copy()
    worst = np.inf
    for halvings in range(_HALVINGS + 1):
        parts, worst = 2**halvings, 0.0
        s[:] = begin
        w.side[:] = side
        for part in range(1, parts + 1):
            w.before[:] = s
            s[0] = place if part == parts else begin[0] + (place - begin[0]) * part / parts
            worst = max(worst, _solve_at_once(s, w, p, d))
            if not worst <= TOLERANCE_MM:
                break
        if worst <= TOLERANCE_MM:
            break
    w.before[:] = begin
    return worst
