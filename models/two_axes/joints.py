"""What joins two bending axes: tendons that are not aligned with them, a sensor frame that is turned, or both.

    w = M u,    y_i = f_i(w_i),    theta = A y,    M = [[1, m_x], [m_y, 1]] P,    A = [[1, a_x], [a_y, 1]]

P exchanges and mirrors commands so that every axis rises with its first one. Of more than two commands, such as those
of tendons, P has the travel of each axis by every command; it minimises the error of the same model without M and A.
The four numbers minimise the error of a model that is linear in plays and lags of w_i, whose weights follow by least
squares (variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973)). Hysteresis tells M from A: of
memoryless linear axes only A M is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from hystmpc.trials.axes import pulls
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Mask, Vec, lagged

from ..play_kernel.predictor import follow_plays
from .model import AXES

RADII = (0.01, 0.03, 0.06, 0.1, 0.16, 0.24, 0.34)
"""Radii of the plays, as shares of the range of a travel."""
LAGS_S = (0.05, 0.15, 0.5, 3.0)
"""Time constants of the lags in front of the travel [s]."""

_INSIDE = 0.05  # distance of a start from that bound
_MOST = 0.8  # greatest size of a number: beyond it, commands would be exchanged
_RIDGE = 1e-6
_WORTH = 0.1  # of the mean square error: what further numbers have to take away
_PARTS = 6  # parts that are left out one after another
_KEPT = 8  # tables of columns
_SAMPLES = 1000  # evaluated samples of every trial, at most
_LEAST_LINK = 0.2  # of the angle's variance that a line by the commands has to explain


@dataclass(frozen=True)
class Joint:
    """Numbers that join the axes.

    Attributes:
        name: `none`, `tendons` (M), `frame` (A) or `both`.
        order: P (2, n); of two commands it has entries 0, 1 and -1.
        mix, frame: M (2, n) and A (2, 2).
    """

    name: str
    order: Vec
    mix: Vec
    frame: Vec


@dataclass(frozen=True, eq=False)
class Chosen:
    """The joint that is kept.

    Attributes:
        joint: of all trials.
        errors: error on the parts left out [deg], by the name of each joint.
    """

    joint: Joint
    errors: dict[str, float]

    @classmethod
    def none(cls) -> Chosen:
        """Two single axes: every command bends its axis alone."""
        return cls(Joint("none", np.eye(AXES), np.eye(AXES), np.eye(AXES)), {})


FREE = {"none": (), "tendons": (0, 1), "frame": (2, 3), "both": (0, 1, 2, 3)}
"""Numbers (m_x, m_y, a_x, a_y) that each joint has."""


def choose_joint(trials: Sequence[Trial]) -> Chosen:
    """Joint of two axes from trials of commands (T, n) and two angles (T, 2).

    Each joint is identified without one part of the trials after another and judged there. Of those whose mean square
    error is within one standard error, or a tenth, of the least one, the one of fewest numbers is kept.

    Raises:
        FitError: if a trial has not two angles, one command alone, or others than the first trial, or an angle does
            not follow the commands.
    """
    count = trials[0].commands.shape[1]
    for trial in trials:
        n, m = trial.commands.shape[1], trial.angles.shape[1]
        if n != count or n < AXES or m != AXES:
            wanted = "two of each" if count <= AXES else f"{count} commands and two angles"
            raise FitError(f"{trial.source}: got {n} commands and {m} angles, expected {wanted}")
    order = _order(trials)
    data = _Data.of(trials, order)
    parts, all_ = np.array_split(np.arange(data.samples), _PARTS), np.ones(data.samples, dtype=bool)
    squares, numbers = {name: np.empty(_PARTS) for name in FREE}, dict[str, Vec]()
    starts = [np.zeros(4), data.straight_numbers()]
    for name, free in FREE.items():
        numbers[name] = data.best_fitted(free, all_, [*starts, *numbers.values()])
        for k, part in enumerate(parts):
            seen = all_.copy()
            seen[part] = False
            q = data.fitted(free, seen, numbers[name])
            squares[name][k] = float(np.mean(data.errors(q, seen)[:, part] ** 2))
    means = {name: float(values.mean()) for name, values in squares.items()}
    best = min(means, key=lambda name: means[name])
    apart = {name: values - squares[best] for name, values in squares.items()}
    slack = {name: max(apart[name].std() / np.sqrt(_PARTS), _WORTH * means[best]) for name in FREE}
    level = [name for name in FREE if means[name] - means[best] <= slack[name]]
    kept = min(level, key=lambda name: (len(FREE[name]), means[name]))
    mix, frame = matrices(numbers[kept])
    return Chosen(
        Joint(kept, order, mix @ order, frame), {name: float(np.sqrt(value)) for name, value in means.items()}
    )


def matrices(q: Vec) -> tuple[Vec, Vec]:
    """M (2, 2) without its order, and A (2, 2), of numbers (m_x, m_y, a_x, a_y)."""
    return np.array([[1.0, q[0]], [q[1], 1.0]]), np.array([[1.0, q[2]], [q[3], 1.0]])


def _order(trials: Sequence[Trial]) -> Vec:
    """P (2, n): which of two commands each axis follows first, and whether it is mirrored; of more, their pulls."""
    u, theta = (
        np.vstack([getattr(t, name) - getattr(t, name).mean(0) for t in trials]) for name in ("commands", "angles")
    )
    if np.any(u.std(0) == 0):
        which = "both" if u.shape[1] == AXES else "every one"
        raise FitError(f"two axes: got a command that does not move, expected motion of {which}")
    gains = np.linalg.lstsq(u, theta, rcond=None)[0].T
    left = (theta - u @ gains.T).var(0) / np.maximum(theta.var(0), 1e-30)
    if np.any(left > 1 - _LEAST_LINK):
        which = "xy"[int(np.argmax(left))]
        raise FitError(
            f"two axes: angle {which} does not follow the commands, {left.max():.0%} of it is left by a line"
        )
    if u.shape[1] > AXES:
        return _refined_pulls(trials, pulls(u, theta))
    sizes = np.abs(gains * u.std(0))
    straight = sizes[0, 0] * sizes[1, 1] >= sizes[0, 1] * sizes[1, 0]
    places = ((0, 0), (1, 1)) if straight else ((0, 1), (1, 0))
    order = np.zeros((AXES, AXES))
    for place in places:
        order[place] = np.sign(gains[place])
    return order


def _refined_pulls(trials: Sequence[Trial], start: Vec) -> Vec:
    """Travels by every command (2, n) of least error of the linear model of each axis, searched from others."""
    count = start.shape[1]
    data = _Data.of(trials, np.eye(count))
    rows = []
    for row, angle in zip(start, data.angles, strict=True):

        def of(values: Vec, row: Vec = row) -> Vec:  # 1 is the start; a change by 1 is one by the size of the row
            moved = row + np.sqrt(2 / count) * (values - 1.0)
            return np.asarray(np.sqrt(2 / count) * moved / np.linalg.norm(moved))

        def error(values: Vec, of: Callable[[Vec], Vec] = of, angle: Vec = angle) -> Vec:
            columns = columns_of([of(values) @ commands for commands in data.commands], data.dts)
            return np.asarray(angle - columns @ weights_of(columns, angle))

        rows.append(of(least_squares(error, np.ones(count), diff_step=1e-3, max_nfev=12).x))
    return np.stack(rows)


@dataclass(frozen=True, eq=False)
class _Data:
    """Signals of all trials on their own grids, one behind the other: P u (2, T), angles (2, T)."""

    commands: list[Vec]
    angles: Vec
    dts: list[float]
    _kept: dict[tuple[float, ...], Vec] = field(default_factory=dict)

    @classmethod
    def of(cls, trials: Sequence[Trial], order: Vec) -> _Data:
        commands, angles, dts = [], [], []
        for trial in trials:
            step = max(len(trial) // _SAMPLES, 1)
            commands.append(np.ascontiguousarray((trial.commands @ order.T)[::step].T))
            angles.append(trial.angles[::step].T)
            dts.append(trial.dt * step)
        return cls(commands, np.hstack(angles), dts)

    @property
    def samples(self) -> int:
        return int(self.angles.shape[1])

    def fitted(self, free: Sequence[int], seen: Mask, start: Vec) -> Vec:
        """Numbers (4,) of least error on the samples seen, searched from others; those that are not free stay."""
        q = start.copy()
        if not free:
            return q

        def error(values: Vec) -> Vec:
            q[list(free)] = values
            return self.errors(q, seen)[:, seen].ravel()

        answer = least_squares(error, start[list(free)], bounds=(-_MOST, _MOST), diff_step=1e-3, max_nfev=12)
        q[list(free)] = answer.x
        return q.copy()

    def best_fitted(self, free: Sequence[int], seen: Mask, starts: Sequence[Vec]) -> Vec:
        """The best of the numbers (4,) that are searched from several starts, of which those that are free count.

        Plays have kinks: near no turn at all, a search may end where an axis begins to leave its smallest play.
        """
        mask = np.isin(np.arange(4), list(free))
        kept = {tuple(np.where(mask, start, 0.0).tolist()): None for start in starts}
        tried = [self.fitted(free, seen, np.array(start)) for start in kept]
        return min(tried, key=lambda q: float(np.sum(self.errors(q, seen)[:, seen] ** 2)))

    def straight_numbers(self) -> Vec:
        """Numbers (4,) by the gains of a line from commands to angles: all of them of the tendons, or of the frame."""
        u = np.hstack([commands - commands.mean(1, keepdims=True) for commands in self.commands])
        (a, b), (c, d) = np.linalg.lstsq(u.T, self.angles.T - self.angles.mean(1), rcond=None)[0].T
        shares = np.array([b / a, c / d, b / d, c / a]) if a and d else np.zeros(4)
        return np.clip(shares, -_MOST + _INSIDE, _MOST - _INSIDE)

    def errors(self, q: Vec, seen: Mask) -> Vec:
        """Errors (2, T) [deg] of the linear model whose weights are those of the samples seen."""
        mix, frame = matrices(q)
        y = np.linalg.solve(frame, self.angles)
        left = np.empty_like(y)
        for axis in range(AXES):
            columns = self._columns(tuple(mix[axis].tolist()))
            left[axis] = y[axis] - columns @ weights_of(columns[seen], y[axis][seen])
        return np.asarray(frame @ left)

    def _columns(self, shares: tuple[float, ...]) -> Vec:
        """Columns (T, K) of a travel with these shares of the commands; the last few are kept."""
        if shares not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[shares] = columns_of([np.array(shares) @ commands for commands in self.commands], self.dts)
        return self._kept[shares]


def columns_of(travels: Sequence[Vec], dts: Sequence[float]) -> Vec:
    """Columns (T, K) of an axis that is linear in one, its travel, its square, its lags and plays.

    Args:
        travels: w of every trial, each at rest in the beginning.
        dts: sample time of every trial [s].
    """
    middle = np.mean([0.5 * (w.min() + w.max()) for w in travels])
    span = max(float(max(w.max() for w in travels) - min(w.min() for w in travels)), 1e-12)
    blocks = []
    for w, dt in zip(travels, dts, strict=True):
        v = np.ascontiguousarray((w - middle) / span)
        slow = [lagged(v, float(np.exp(-dt / lag))) for lag in LAGS_S]
        gain, start = 1 - float(np.exp(-dt / LAGS_S[0])), np.full(1 + len(RADII), v[0])
        plays = follow_plays(v, gain, np.array(RADII), start)
        blocks.append(np.column_stack([np.ones(v.size), v, v * v, *slow, plays]))
    return np.vstack(blocks)


def weights_of(columns: Vec, target: Vec) -> Vec:
    """Weights (K,) of least squares on a target (T,), with a slight ridge."""
    square = columns.T @ columns
    square += _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    return np.asarray(np.linalg.solve(square, columns.T @ target))
