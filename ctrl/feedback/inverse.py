"""Inverse feedforward, alone and with PID feedback: the command that the model's inverse asks for.

S2 is RA-L 2024, PMC11633443.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, final

import numpy as np

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from ..command import EMPTY, ControlInput, Source, Stopwatch
from ..frozen import replace
from ..law import Law, Proposal
from ..limits import CommandLimits
from .pid import Pid, PidMemory, is_new

if TYPE_CHECKING:
    from ..planning import CommandPlan

REFERENCE_DEAD_ZONE_DEG = 0.027  # 0.0003 of 90 deg, RA-L 2024, PMC11633443 (S2)


@dataclass(frozen=True, eq=False)
class FeedforwardMemory:
    """The angle followed at present [deg], and what is left of the last plan of commands (0..H,)."""

    followed: float
    plan: Vec = field(default_factory=lambda: EMPTY)


class AheadOfTime(Protocol):
    """An inverse over a preview, such as `FeasibleInverse`."""

    horizon: int

    def plan(self, state: Vec, u_last: float, wanted: Vec, remaining: Vec, tolerance_deg: float) -> CommandPlan:
        """The commands along wanted angles (H,) [deg]; see `FeasibleInverse.plan`."""
        ...


@final
class InverseFeedforward(Law[FeedforwardMemory]):
    """u = inverse(x, theta_ref): no feedback; the memory x comes from the commands really sent.

    A reference that changes by less than the dead zone is not followed: any noise on it would flip the branch of
    the inverse and jump across the whole dead band (RA-L 2024, PMC11633443 (S2), inverse backlash).

    Args:
        ahead: plans over a preview, for a model with lag or delay; None for the inverse sample by sample.
    """

    source = Source.CONTROLLER

    def __init__(
        self,
        inverse: Inverse,
        dead_zone_deg: float = REFERENCE_DEAD_ZONE_DEG,
        ahead: AheadOfTime | None = None,
    ) -> None:
        self._inverse, self._dead_zone, self._ahead = inverse, dead_zone_deg, ahead
        self.horizon = 1 if ahead is None else ahead.horizon

    def init(self, y: float, u: float) -> FeedforwardMemory:
        del u
        return FeedforwardMemory(y)

    def propose(self, memory: FeedforwardMemory, given: ControlInput, watch: Stopwatch) -> Proposal[FeedforwardMemory]:
        wanted = np.array(given.reference[: self.horizon])
        before = memory.followed
        for k, angle in enumerate(wanted.tolist()):
            before = wanted[k] = angle if abs(angle - before) >= self._dead_zone else before
        followed = float(wanted[0])
        if self._ahead is None:
            u = self._inverse.command(given.state, followed, given.u_last)
            watch.lap("inverse")
            return Proposal(u, FeedforwardMemory(followed))
        plan = self._ahead.plan(given.state, given.u_last, wanted, memory.plan, self._dead_zone)
        watch.lap("inverse")
        return Proposal(
            float(plan.commands[0]), FeedforwardMemory(followed, plan.commands[1:]), plan.commands, plan.angles
        )


@dataclass(frozen=True, eq=False)
class InversePidMemory:
    """The memories of both parts, and the model state (S,) under the feedforward command alone.

    Attributes:
        dues: angles that were due at the last instants, the newest last [deg].
        error: of the last measurement [deg].
    """

    feedforward: FeedforwardMemory
    pid: PidMemory
    state: Vec
    u: float
    dues: tuple[float, ...] = ()
    error: float = 0.0


@final
class InversePid(Law[InversePidMemory]):
    """u = inverse(x_ff, theta_ref) + PID(theta_due - y).

    The feedback compares the measurement with the angle that was due when it was taken, so that a perfect
    feedforward leaves it nothing to do; without a new measurement the error stays. The inverse remembers its own
    commands x_ff, not the sum: otherwise it would take every correction for an error of its own and go back across the
    dead band to undo it.

    Args:
        oldest: age of the oldest measurement [samples].
    """

    source = Source.CONTROLLER

    def __init__(
        self, feedforward: InverseFeedforward, pid: Pid, predictor: Predictor, limits: CommandLimits, oldest: int = 0
    ) -> None:
        self.horizon = feedforward.horizon
        self._feedforward, self._pid, self._kept = feedforward, pid, oldest + 1
        self._predictor, self._limits = predictor, limits

    def init(self, y: float, u: float) -> InversePidMemory:
        state = self._predictor.initial(y, u)
        return InversePidMemory(self._feedforward.init(y, u), PidMemory(0.0, 0.0, y), state, u)

    def taken_over(self, given: ControlInput) -> InversePidMemory:
        """The memory with which it takes over from another law without a jump of the command."""
        before = self._feedforward.init(given.due, given.u_last)
        alone = self._feedforward.propose(before, given, Stopwatch())
        u_alone = self._limits.clip(alone.u, given.u_last, self._predictor.dt)
        pid = self._pid.taken_over(given.due - given.measured, given, u_alone)
        return InversePidMemory(before, pid, given.state, given.u_last)

    def propose(self, memory: InversePidMemory, given: ControlInput, watch: Stopwatch) -> Proposal[InversePidMemory]:
        alone = replace(given, state=memory.state, u_last=memory.u)
        wanted = self._feedforward.propose(memory.feedforward, alone, watch)
        u_alone = self._limits.clip(wanted.u, memory.u, self._predictor.dt)
        _, state = self._predictor.advance(memory.state, u_alone)
        watch.lap("inverse")
        dues, error = (*memory.dues, given.due)[-self._kept :], memory.error
        if is_new(memory.pid, given):
            error = dues[-1 - min(round(given.age), len(dues) - 1)] - given.measured
        u, pid = self._pid.correct(memory.pid, error, given, u_alone)
        watch.lap("pid")
        return Proposal(u, InversePidMemory(wanted.memory, pid, state, u_alone, dues, error))
