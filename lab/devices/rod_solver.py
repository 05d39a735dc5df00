"""The rod device, compiled: equations of its tendon, segments and friction, and one implicit step of all of them.

A tendon passes m contacts with its lumen: p in the shaft, then n at the entrances of the rod's segments. Span j lies
behind contact j, j = 0..m, span 0 before the first. With s_j the tendon's displacement in the lumen at contact j [mm]
(towards the drive; s_0 is the drive, s_{m+1} = 0 the tip), q_j the bend of the span's segment and T_j its tension:

    T_j = max(0, (s_j - s_{j+1} - r (q_j - rest_j)) / c_j)                        elastic, and it can only pull
    r T_j + G_j = K_0 (q_j - rest_j - set (R_j - rest_j)) + K_1 (q_j - z_1j) + K_2 (q_j - z_2j)
    R_j = the greatest q_j so far,  z_b' = (q - z_b) / tau_b                      set of the first flexure, relaxation
    T_{j-1} <= T_j exp(mu phi_j) + h_j,  with equality where the tendon slips towards the drive
    T_j <= T_{j-1} exp(mu phi_j) + h_j,  with equality where it slips towards the tip, and no slip otherwise

phi_j is the wrap angle at the contact: a constant share of the shaft's bend, or |q_j|. With h = 0 the last two are the
capstan equation of Euler and Eytelwein; h is the drag of a contact load that does not come from the tension.

One step is a semi-smooth Newton iteration over stick and slip, with shooting as its net. Unknown are the displacements
s_1..s_m at the contacts; with ds_j the change in this step and

    F+_j = T_{j-1} - exp(mu phi_j) T_j - h_j   (<= 0: whether it may slip towards the drive)
    F-_j = T_j - exp(mu phi_j) T_{j-1} - h_j   (<= 0: towards the tip)

the set-valued friction law is one equation a contact, for any rho > 0 [mm/N] (here that of the stiffer neighbour, else
the choice of stick or slip overshoots):

    ds_j = max(0, ds_j + rho F+_j) + min(0, ds_j - rho F-_j)

It is piecewise smooth, F+ rises with both neighbours' displacements and falls with its own (F- the other way round), so
the Newton matrix is tridiagonal with a dominant diagonal (Facchinei and Pang, 2003, ch. 7). Three to six iterations are
usual; where it circles, at the edge of slack or after jumps, `shoot` solves the same law by roots of scalars.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

_UP, _STICKS, _DOWN, _LOOSE = 1, 0, -1, -2
_ROUNDS = 400  # doubles are exhausted long before
_EXACT = 1e-13  # [mm or N]

TOLERANCE_MM = 1e-9
"""Greatest residual of the friction law that a step may leave [mm]."""

_NEWTON = 20  # greatest number of iterations
_GRAVITY_ROUNDS = 100
_GRAVITY_MM = 1e-10


class RodNumbers(NamedTuple):
    """Parameters in the form of the equations; lengths mm, forces N, angles rad, stiffness N mm/rad, arrays by span."""

    shaft_contacts: int
    segments: int
    compliance: Any  # (m + 1,) c_j [mm/N]
    wrap: Any  # (m + 1,) constant wrap at contact j, shaft only; entry 0 is unused
    drag: Any  # (m + 1,) h_j; entry 0 is unused
    mu: float
    offset: float  # r
    rest: float  # natural bend of one segment
    stiffness: float  # K_0
    branch_stiffness: tuple[float, float]  # K_1, K_2
    set_share: float
    pretension: float  # drive displacement of the untensioned tendon, below 0 of the command
    weight: float  # of one segment
    length: float  # of one segment
    down: float  # angle from the base's axis to the pull of gravity


class StepNumbers(NamedTuple):
    """Constants of a step of one length; z_b after a step is keep z_b + old q_before + new q_after."""

    keep: tuple[float, float]
    old: tuple[float, float]
    new: tuple[float, float]
    drive_share: float


@njit(cache=True, error_model="numpy", inline="always")
def span(stretch: float, load: float, reached: float, j: int, p: RodNumbers, d: StepNumbers) -> Any:
    """Tension, bend, and their derivatives by `stretch` = s_j - s_{j+1}, of span j.

    `load` is the moment that does not come from bend or tendon now: gravity and what the Maxwell branches remember.
    """
    if j <= p.shaft_contacts:
        slope = 1.0 / p.compliance[j]
        return (slope * stretch, 0.0, slope, 0.0) if stretch > 0 else (0.0, 0.0, 0.0, 0.0)
    late = p.branch_stiffness[0] * (1 - d.new[0]) + p.branch_stiffness[1] * (1 - d.new[1])
    whole = p.stiffness + late
    free = (load + p.stiffness * (p.rest + p.set_share * (reached - p.rest))) / whole  # bend at no tension
    slope = 1.0 / (p.compliance[j] + p.offset * p.offset / whole)
    tension = slope * (stretch - p.offset * (free - p.rest))
    bend = free + p.offset * max(tension, 0.0) / whole
    if bend > reached:  # the set grows with the bend: a softer law that meets the other at q = reached
        whole = p.stiffness * (1 - p.set_share) + late
        free = (load + p.stiffness * (1 - p.set_share) * p.rest) / whole
        slope = 1.0 / (p.compliance[j] + p.offset * p.offset / whole)
        tension = slope * (stretch - p.offset * (free - p.rest))
        bend = free + p.offset * max(tension, 0.0) / whole
    if tension <= 0:
        return 0.0, bend, 0.0, 0.0
    return tension, bend, slope, p.offset * slope / whole


@njit(cache=True, error_model="numpy", inline="always")
def grip(j: int, bend: float, p: RodNumbers) -> float:
    """Capstan factor exp(mu phi) of contact j; `bend` is that of span j."""
    return math.exp(p.mu * (p.wrap[j] if j <= p.shaft_contacts else abs(bend)))


@njit(cache=True, error_model="numpy")
def gravity(bends: Any, moments: Any, p: RodNumbers) -> None:
    """Moments (n,) of the segments' weights at their joints, each weight in the middle of its segment."""
    heading, across = 0.0, 0.0
    for i in range(p.segments):  # first pass: where the middle of each segment lies, across the pull of gravity
        heading += bends[i]
        across += 0.5 * p.length * math.sin(heading - p.down)
        moments[i] = across
        across += 0.5 * p.length * math.sin(heading - p.down)
    total, weights, joint = 0.0, 0.0, across
    for i in range(p.segments - 1, -1, -1):
        middle = moments[i]
        joint = 2 * middle - joint  # the segment's own entrance
        total += middle
        weights += 1.0
        moments[i] = -p.weight * (total - weights * joint)


class Knots(NamedTuple):
    """Direction changes of each contact, by contact 0..m (entry 0 unused), and memory for one evaluation."""

    sticks: Any  # (m + 1,) sigma below which it no longer sticks, of the curve beyond it
    width: Any  # (m + 1,) of sigma in which it sticks [N]
    loose: Any  # (m + 1,) sigma below which the piece behind it is slack
    least: Any  # (m + 1,) tension behind it at `sticks` [N]
    way: Any  # (m + 1,) of the evaluation
    given: Any  # (m + 1,) tau behind a contact that sticks or is loose


def new_knots(contacts: int) -> Knots:
    """Memory for that many contacts."""
    return Knots(*(np.zeros(contacts + 1) for _ in range(6)))


@njit(cache=True, error_model="numpy", inline="always")
def _stretch(tau: float, load: float, reached: float, j: int, p: RodNumbers, d: StepNumbers) -> Any:
    """Stretch s_j - s_{j+1} and bend of span j at tau, and their slopes: the inverse of `span`."""
    if j <= p.shaft_contacts:
        return p.compliance[j] * tau, 0.0, p.compliance[j], 0.0
    late = p.branch_stiffness[0] * (1 - d.new[0]) + p.branch_stiffness[1] * (1 - d.new[1])
    moment, whole = load + p.offset * max(tau, 0.0), p.stiffness + late
    bend = (moment + p.stiffness * (p.rest + p.set_share * (reached - p.rest))) / whole
    if bend > reached:
        soft = p.stiffness * (1 - p.set_share)
        whole = soft + late
        bend = (moment + soft * p.rest) / whole
    further = p.offset / whole if tau > 0 else 0.0
    return p.compliance[j] * tau + p.offset * (bend - p.rest), bend, p.compliance[j] + p.offset * further, further


@njit(cache=True, error_model="numpy")
def _at(sigma: float, near: int, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers) -> Any:
    """Set s_near..s_m from `sigma` of the curve (s_near, tau_near); return tau_near [N], and both slopes by sigma."""
    m = p.compliance.size - 1
    for j in range(near + 1, m + 1):
        if sigma >= k.sticks[j] + k.width[j]:
            k.way[j], sigma = _UP, sigma - k.width[j]
        elif sigma >= k.sticks[j]:
            k.way[j], k.given[j], sigma = _STICKS, k.least[j] + (sigma - k.sticks[j]), k.sticks[j]
        elif sigma >= k.loose[j]:
            k.way[j] = _DOWN
        else:
            k.way[j], k.given[j], sigma = _LOOSE, sigma - k.loose[j], k.loose[j]
    tau, tau_slope, slope, s[m + 1] = sigma, 1.0, 0.0, 0.0
    for j in range(m, near - 1, -1):
        stretch, bend, longer, further = _stretch(tau, w.load[j], w.reached[j], j, p, d)
        s[j], slope = s[j + 1] + stretch, slope + longer * tau_slope
        if j == near:
            break
        a = grip(j, bend, p)
        steep = p.mu * further * (1.0 if bend > 0 else -1.0)  # of a, over a
        if k.way[j] == _UP:
            tau_slope = a * (1.0 + steep * tau) * tau_slope if tau > 0 else 0.0
            tau = a * max(tau, 0.0) + p.drag[j]
        elif k.way[j] == _DOWN:
            tau = max(tau - p.drag[j], 0.0) / a
            tau_slope = tau_slope / a - tau * steep * tau_slope
        else:
            tau, tau_slope, slope = k.given[j], 1.0, 0.0
            if k.way[j] == _STICKS:
                s[j] = w.before[j]
    return tau, tau_slope, slope


@njit(cache=True, error_model="numpy")
def _root(
    wanted: float, of_place: bool, begin: float, near: int, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers
) -> float:
    """Sigma at which s_near, or tau_near, is `wanted`; both rise with it. Newton within brackets, else bisection."""
    low, high, at, reach, last = -np.inf, np.inf, begin, 1.0, np.inf
    for _ in range(_ROUNDS):
        tau, tau_slope, slope = _at(at, near, s, w, k, p, d)
        value, slope = (s[near] - wanted, slope) if of_place else (tau - wanted, tau_slope)
        if abs(value) <= _EXACT:
            break
        if value < 0:
            low = at
        else:
            high = at
        step = -value / slope if slope > 0 else np.inf
        if low < at + step < high and abs(step) < 0.5 * last:
            at, last = at + step, abs(step)
            continue
        last = np.inf
        if low == -np.inf or high == np.inf:
            at, reach = at - np.sign(value) * reach, 4 * reach
            continue
        at = 0.5 * (low + high)
        if not low < at < high:
            break
    return at


@njit(cache=True, error_model="numpy")
def shoot(place: float, s: Any, w: Any, k: Knots, p: RodNumbers, d: StepNumbers) -> None:
    """Set the displacements s (m + 2,) and the sides of `w` to their values after the drive has reached `place`."""
    m, sigma = p.compliance.size - 1, 0.0
    for j in range(m, 0, -1):
        sigma = _root(w.before[j], True, sigma, j, s, w, k, p, d)
        tau = max(_at(sigma, j, s, w, k, p, d)[0], 0.0)
        a = grip(j, _stretch(tau, w.load[j], w.reached[j], j, p, d)[1], p)
        k.least[j] = max(tau - p.drag[j], 0.0) / a
        k.sticks[j], k.width[j], k.loose[j] = sigma, a * tau + p.drag[j] - k.least[j], sigma
        if tau > p.drag[j]:
            k.loose[j] = min(_root(p.drag[j], False, sigma, j, s, w, k, p, d), sigma)
    _at(_root(place, True, sigma, 0, s, w, k, p, d), 0, s, w, k, p, d)
    s[0] = place
    for j in range(1, m + 1):
        w.side[j] = k.way[j] if k.way[j] > _LOOSE else 0.0


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
    """Capstan factor exp(mu phi), F+ and F- of contact j."""
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
        goes_on = guess * w.side[j]  # first guess: contacts that slipped before slip again
        free = forward == -backward  # without friction the tensions are equal for either slip direction
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
    """Displacements s (m + 2,) after the drive has reached `place`; returns the remaining residual [mm].

    `w` holds initial state and loads, and afterwards tensions and bends; its `side` is the last slip.
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
    """Set the bending moments besides the tendon's, from `moments` (n,) of gravity, `bends` (n,) and `late` (2, n)."""
    for i in range(p.segments):
        load = moments[i]
        for b in range(2):
            load += p.branch_stiffness[b] * (d.keep[b] * late[b, i] + d.old[b] * bends[i])
        w.load[p.shaft_contacts + 1 + i] = load


@njit(cache=True, error_model="numpy")
def _step(
    place: float, s: Any, bends: Any, late: Any, moments: Any, w: Work, k: Knots, p: RodNumbers, d: StepNumbers
) -> float:
    """Step displacements, bends (n,) and branches (2, n) with the drive going to `place`; return the residual."""
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
    """Advance `state` through commands (T,), each in `parts` steps; outputs (T,). Returns the greatest residual [mm].

    State (1 + 2 m + 4 n,): drive, displacements at the contacts [mm], last slip direction of each (1, -1, or 0), bends,
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
