"""Quadratic program of a planning step, and its solution by OSQP as the engine calls it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from threading import local
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.core.library import engine
from hystmpc.core.outside import keep_fault, numbers_at
from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.types import Mat, Vec

from ..command import CommandLimits
from ..law_tables import law_over
from ..mpc_settings import WeightsSettings
from .qp import OsqpOptions, QpData, QpPattern


@dataclass(frozen=True, eq=False)
class PlanningTask:
    """What is planned for; every angle in it is the model's, without the output disturbance."""

    u_last: float  # the command really sent last
    rate_weight: float  # on its moves
    reference: Vec  # wanted angles [deg], shape (H,)
    feedforward: Vec  # the inverse plan, from which effort is measured, shape (H,)
    angle_limits: tuple[float, float]  # soft limits of the angle [deg], lower and upper
    following: PlanningTask | None = None  # that of the next axis

    @cached_property
    def part(self) -> Struct:
        """Struct `hystmpc_task` of core/law.h."""
        low, high = self.angle_limits
        return struct(
            "hystmpc_task",
            reference=self.reference,
            feedforward=self.feedforward,
            u_last=self.u_last,
            rate_weight=self.rate_weight,
            low=low,
            high=high,
            next=None if self.following is None else self.following.part,
        )


@final
class PlanProgram:
    """Quadratic program of the planning cost with linearised angles, in the deviation v of the commands from a plan p.

        theta(p + v) ~ theta_p + J v
        P = 2 (J'QJ + w_r D'D + w_e I),  q = 2 (J'Q (theta_p - r) + w_r D'(D p - e_1 u_last) + w_e (p - f))
        lower <= p + v <= upper,  -rate dt <= D (p + v) - e_1 u_last <= rate dt

    with D the difference matrix. Soft angle limits add H free variables s with cost w_s s^2 and the rows
    a <= theta_p + J v + s <= b, which is the squared distance to [a, b] exactly.

    With blocks of moves the unknowns are the deviations w (m,) at their ends, v = M w, and the rate of all samples of
    block b, in which the move of v is constant, is one row:

        P = 2 ((J M)'Q (J M) + w_r (D M)'D M + w_e M'M),  q = M' q_full
        L_b (-rate dt - min D p) <= w_b - w_{b-1} <= L_b (rate dt - max D p),  min and max over block b

    Rows stand in the order of the samples, one axis after the other; the engine fills them, see core/law.c. A law of
    several axes has nu commands and ny angles: then p, v are (nu, H), theta_p, r, s (ny, H) and J (ny, H, nu, H).

    Args:
        law: `hystmpc_law` of all axes, see `law_over`.

    Attributes:
        pattern: of all programs of these settings.
    """

    def __init__(self, law: Struct) -> None:
        self._law, self._axes, horizon = law, list(_axes_of(law)), law.fields["horizon"]
        self._rows = self._count = 0
        tasks: PlanningTask | None = None
        moves: list[NDArray[np.intp]] = []  # rows: of each sample the command, then the angle; first the block's move
        rest = np.zeros(horizon)
        for axis in self._axes:
            tasks = PlanningTask(0.0, 1.0, rest, rest, (0.0, 0.0), tasks)
            soft = horizon if axis["soft"] and "tracking" in axis else 0
            if axis["moves"]:
                moves.append(self._rows + axis["starts"] * (1 + bool(soft)) + np.arange(axis["moves"]))
                self._rows += horizon + axis["moves"]
                self._count += axis["moves"]
            self._rows += soft
        self._inputs = len(moves)
        self._moves = np.concatenate(moves)
        self._touching = np.concatenate(
            [1e-6 * a["reach"] * (a["ends"] + 1 - a["starts"]) for a in self._axes[: self._inputs]]
        )
        angles = np.zeros((sum("tracking" in axis for axis in self._axes), horizon))
        plan = np.zeros((self._inputs, horizon))
        slopes = np.broadcast_to(np.tri(horizon)[:, None], (len(angles), horizon, self._inputs, horizon))
        assert tasks is not None
        free = self.data(tasks, plan, angles, slopes)
        self.pattern = QpPattern(free.columns != 0.0, free.soft > 0.0)

    def data(self, task: PlanningTask, commands: Vec, angles: Vec, jacobian: Mat) -> QpData:
        """Return the program around a plan.

        Args:
            commands, angles: of the plan (H,), or (nu, H) and (ny, H).
            jacobian: of the angles (H, H) or (ny, H, nu, H), zero where the command is later [deg per command unit].
        """
        count, rows = self._count, self._rows
        hessian, gradient, by_column, bounds = (np.empty(s) for s in ((count, count), count, (count, rows), (3, rows)))
        known = self._law.address, task.part.address, np.ascontiguousarray(jacobian), commands, angles, self._room()
        engine().program(*known, hessian, gradient, by_column, bounds)
        lower, upper, soft = bounds
        return QpData(hessian, gradient, by_column, lower, upper, soft, self._multipliers(gradient, lower, upper))

    def deviation(self, primal: Vec) -> Vec:
        """Return the deviation of the commands from the plan (H,) or (nu H,) in a solution z = `primal` (m,)."""
        parts = zip(self._axes, self._by_input(primal), strict=False)
        return np.concatenate([axis["blocking"] @ w if "blocking" in axis else w for axis, w in parts])

    def after(self, task: PlanningTask, commands: Vec, angles: Vec, jacobian: Mat, primal: Vec) -> Vec:
        """Return the admissible plan after the solution z = `primal`, with its foreseen cost (nu H + 1,)."""
        out = np.empty(commands.size + 1)
        known = self._law.address, task.part.address, np.ascontiguousarray(jacobian), commands, angles
        engine().plan_after(*known, np.ascontiguousarray(primal), self._room(), out)
        return out

    def _by_input(self, unknowns: Vec) -> list[Vec]:
        """Numbers of all unknowns (m,), those of each command apart."""
        return np.split(unknowns, np.cumsum([axis["moves"] for axis in self._axes[: self._inputs]])[:-1])

    def _room(self) -> Vec:
        return np.empty(engine().law_bytes(self._law.address), dtype=np.uint8)

    def _multipliers(self, gradient: Vec, lower: Vec, upper: Vec) -> Vec:
        """Multipliers (R,) that hold a plan at the greatest rate where it already has it.

        Stationarity D'y = -q, solved backwards in time, of the right sign, and zero where the rate limit is not
        touched. First-order methods take thousands of iterations to find these, and the best candidates of a reversal
        touch the limit over many samples.
        """
        dual = np.zeros(lower.size)
        balance = np.concatenate([-np.cumsum(part[::-1])[::-1] for part in self._by_input(gradient)])
        fast, slow = upper[self._moves] <= self._touching, lower[self._moves] >= -self._touching
        held = np.where(fast, np.maximum(balance, 0.0), np.where(slow, np.minimum(balance, 0.0), 0.0))
        dual[self._moves] = held
        return dual


@final
class IterativeSolution:
    """Solution of a planning step's program by OSQP, as the engine calls it: `solve` of core/planner.h.

    Args:
        blocks: samples of each block of moves; None if every sample may move.
    """

    def __init__(
        self,
        weights: WeightsSettings,
        limits: CommandLimits,
        horizon: int,
        dt: float,
        blocks: tuple[int, ...] | None,
        options: OsqpOptions,
    ) -> None:
        self._program = PlanProgram(law_over(weights, horizon, limits, dt, blocks))
        self._solver = options.solver(self._program.pattern)
        self._horizon, self._local = horizon, local()

    @property
    def words(self) -> str:
        """Words of this thread's last solution."""
        return str(getattr(self._local, "words", ""))

    def __call__(
        self, reference: int, feedforward: int, scalars: int, jacobian: int, commands: int, angles: int, out: int
    ) -> int:
        """Solve the program around a plan; 0, 1 where the iterations ran out, or a negative number for no solution."""
        size = self._horizon
        u_last, rate, low, high = numbers_at(scalars, 4).tolist()
        wanted, feed, plan, along = (numbers_at(at, size) for at in (reference, feedforward, commands, angles))
        slopes = numbers_at(jacobian, size, size)
        try:
            task = PlanningTask(u_last, rate, wanted, feed, (low, high))
            data = self._program.data(task, plan, along, slopes)
            if not np.isfinite(data.hessian.sum() + data.gradient.sum()):
                return _NO_PROGRAM if np.isfinite(slopes.sum()) else _NO_JACOBIAN
            solution = self._solver.solve(data)
        except BaseException as error:  # noqa: BLE001 - through C no exception passes
            keep_fault(error)
            return _NO_ANSWER
        self._local.words = f"OSQP: {solution.status}"
        if not solution.usable:
            return _NOT_FINITE
        numbers_at(out, size + 1)[:] = self._program.after(task, plan, along, slopes, solution.primal)
        return int(solution.unfinished)


_NO_JACOBIAN, _NO_PROGRAM, _NO_ANSWER, _NOT_FINITE = (
    constants()[f"HYSTMPC_{name}"] for name in ("NO_JACOBIAN", "NO_PROGRAM", "NO_ANSWER", "QP_NOT_FINITE")
)


def _axes_of(law: Struct | None) -> Iterator[Mapping[str, Any]]:
    """Fields of the law of each axis."""
    while law is not None:
        yield law.fields
        law = law.fields.get("next")
