"""Inverse feedforward corrected by PID feedback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

from .command import Source
from .inverse_feedforward import FeedforwardMemory, InverseFeedforward
from .law import Law, Proposal, Situation
from .limits import CommandLimits
from .pid import Pid, PidMemory
from .stopwatch import Stopwatch


@dataclass(frozen=True, eq=False)
class InversePidMemory:
    """The memories of both parts, and the model state (S,) under the feedforward command alone."""

    feedforward: FeedforwardMemory
    pid: PidMemory
    state: Vec
    u: float


@final
class InversePid(Law[InversePidMemory]):
    """u = inverse(x_ff, theta_ref) + PID(theta_due - y).

    The feedback compares the measurement with the angle that was due at that instant, so that a perfect
    feedforward leaves it nothing to do. The inverse remembers its own commands x_ff, not the sum: otherwise it
    would take every correction for an error of its own and go back across the dead band to undo it.
    """

    horizon = 1
    source = Source.CONTROLLER

    def __init__(self, feedforward: InverseFeedforward, pid: Pid, predictor: Predictor, limits: CommandLimits) -> None:
        self._feedforward, self._pid = feedforward, pid
        self._predictor, self._limits = predictor, limits

    def init(self, y: float, u: float) -> InversePidMemory:
        state = self._predictor.initial(y, u)
        return InversePidMemory(self._feedforward.init(y, u), PidMemory(0.0, 0.0, y), state, u)

    def propose(self, memory: InversePidMemory, situation: Situation, watch: Stopwatch) -> Proposal[InversePidMemory]:
        alone = replace(situation, state=memory.state, u_last=memory.u)
        wanted = self._feedforward.propose(memory.feedforward, alone, watch)
        u_alone = self._limits.clip(wanted.u, memory.u, self._predictor.dt)
        _, state = self._predictor.advance(memory.state, u_alone)
        watch.lap("inverse")
        y = situation.measured
        u, pid = self._pid.correct(memory.pid, situation.due - y, y, situation.u_last, u_alone)
        watch.lap("pid")
        return Proposal(u, InversePidMemory(wanted.memory, pid, state, u_alone))
