"""The work that is timed: the steps of one closed-loop scan, recorded once and repeated by everybody."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from hystmpc.ctrl.command import Command
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.planning import PlanningProblem
from hystmpc.trials.types import Vec

from .subjects import Subject

T = TypeVar("T")
_SETTLING = 25  # samples from rest to the scan, left out


@dataclass(frozen=True, eq=False)
class Instant:
    """One step of the recorded loop: what came in, and the command that went out."""

    state: GuardedState[Any]
    measured: float
    reference: Vec
    command: Command

    @property
    def problem(self) -> PlanningProblem:
        """The planning problem of this step, for whoever solves it instead; no effort, no angle limits."""
        wanted = self.reference - self.command.disturbance
        estimate = self.state.estimate
        nothing = np.zeros(wanted.size)
        return PlanningProblem(estimate.state, estimate.command, wanted, nothing, (-np.inf, np.inf))


def record_scan(controller: GuardedController[Any], subject: Subject) -> list[Instant]:
    """One period of the scan with the model as plant, after the way to it from rest."""
    rest = subject.limits.lower
    y, _ = subject.predictor.advance(subject.predictor.initial(subject.metadata.trained_angle.lower, rest), rest)
    state = controller.init(y, rest)
    instants = []
    for k in range(_SETTLING + subject.scan_samples):
        reference = subject.scan(k + 1, controller.horizon)
        command, following = controller.step(state, y, reference)
        instants.append(Instant(state, y, reference, command))
        state, y = following, following.estimate.angles[0]
    return instants[_SETTLING:]


def in_turn(items: Sequence[T], call: Callable[[int, T], object]) -> Callable[[], object]:
    """A call without arguments that goes through `items`, over and over, with their numbers."""
    position = -1

    def run() -> object:
        nonlocal position
        position = (position + 1) % len(items)
        return call(position, items[position])

    return run
