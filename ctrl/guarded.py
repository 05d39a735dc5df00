"""Every controller of hystmpc: a law inside an estimator, a ladder and hard limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar, final

import numpy as np

from hystmpc.trials.errors import ControllerError, HystmpcError
from hystmpc.trials.types import Vec

from .command import EMPTY, Command, Timing
from .inputs import ANGLE_BOUND_DEG, UnusableReferenceError, usable_angle, usable_reference
from .ladder import Ladder, LadderState, Rung, attempt
from .law import Law, Proposal, Situation
from .limits import CommandLimits
from .observer import Estimate, Observer
from .stopwatch import Stopwatch

M = TypeVar("M")
N = TypeVar("N")


@dataclass(frozen=True, eq=False)
class GuardedState(Generic[M]):
    """Everything a controller remembers: the state is its own snapshot.

    Attributes:
        estimate: observer snapshot, with the command really sent last.
        memory: the law's own memory.
        ladder: failure counters and remaining plan.
        due: the angle that was wanted at the present instant [deg].
    """

    estimate: Estimate
    memory: M
    ladder: LadderState
    due: float


@final
class GuardedController(Generic[M]):
    """Wraps a law so that a step never raises and never leaves the limits (architecture, section 4).

    Order of one step: correct the estimate with the measurement, check the reference, let the law propose, take
    the proposal or a rung of the ladder, limit from the command really sent, advance the model with the result.

    Args:
        law: what the controller wants.
        observer: state and disturbance estimate.
        ladder: what to do on failure.
        limits: hard limits on command and command rate.
        dt: sample time [s].
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.

    Raises:
        ControllerError: if `dt` is not above zero or `max_missing_samples` is negative.
    """

    def __init__(
        self,
        law: Law[M],
        observer: Observer,
        ladder: Ladder,
        limits: CommandLimits,
        dt: float,
        max_missing_samples: int = 25,
    ) -> None:
        if not (math.isfinite(dt) and dt > 0) or max_missing_samples < 0:
            raise ControllerError(
                f"controller: got dt {dt}, max_missing_samples {max_missing_samples}, expected > 0 s and >= 0"
            )
        self._law, self._observer, self._ladder, self._limits = law, observer, ladder, limits
        self._dt = dt
        self._max_missing = max_missing_samples

    @property
    def law(self) -> Law[M]:
        """What the controller wants, before ladder and limits."""
        return self._law

    def with_law(self, law: Law[N]) -> GuardedController[N]:
        """The same estimator, ladder and limits around another law, one that wraps its own for example."""
        return GuardedController(law, self._observer, self._ladder, self._limits, self._dt, self._max_missing)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._dt

    @property
    def horizon(self) -> int:
        """Reference samples that `step` looks at: the law's own and those that pass before a command acts."""
        return self._law.horizon + self._observer.delay_samples

    def init(self, y: float, u: float) -> GuardedState[M]:
        """State at rest.

        Raises:
            ControllerError: if `y` or `u` is not finite, `u` is beyond the limits, or the model fails at rest.
        """
        low, high = self._limits.lower, self._limits.upper
        if not (math.isfinite(usable_angle(y)) and low <= u <= high):
            raise ControllerError(
                f"controller: got a start at {y} deg with command {u}, expected a finite angle within "
                f"{ANGLE_BOUND_DEG:.0f} deg and a command within {low} to {high}"
            )
        try:
            return GuardedState(self._observer.init(y, u), self._law.init(y, u), LadderState(), float(y))
        except HystmpcError:
            raise
        except Exception as error:
            raise ControllerError(f"controller: the model fails at rest ({y} deg, command {u}): {error}") from error

    def replay(self, commands: Vec, angles: Vec) -> GuardedState[M]:
        """State after a recording: as if the controller had seen these angles and sent these commands itself.

        Args:
            commands: sent last (T,) [mm or bar], the newest at the end.
            angles: measured when each was sent (T,) [deg]; not-a-number where there was none. The device is taken to
                have rested at the first usable one, under the command sent then.

        Raises:
            ControllerError: if no angle is usable, a command is beyond the limits, or the model fails.
        """
        usable = np.flatnonzero([math.isfinite(usable_angle(y)) for y in angles])
        low, high = self._limits.lower, self._limits.upper
        if commands.shape != angles.shape or not usable.size or not np.all((commands >= low) & (commands <= high)):
            raise ControllerError(
                f"replay: got {commands.size} commands and {angles.size} angles, {usable.size} of them usable, "
                f"expected as many commands within {low} to {high} as angles, at least one of them usable"
            )
        first = int(usable[0])
        state = self.init(float(angles[first]), float(commands[first]))
        estimate, last = state.estimate, float(angles[usable[-1]])
        for y, u in zip(angles[first:].tolist(), commands[first:].tolist(), strict=True):
            after, fault = attempt(partial(self._observer.advance, self._observer.correct(estimate, y), u))
            if after is None:
                raise ControllerError(f"replay: the model fails at command {u}: {fault}")
            estimate = after
        return replace(state, estimate=estimate, memory=self._law.init(last, estimate.command), due=last)

    def stop(self, state: GuardedState[M], cause: str) -> GuardedState[M]:
        """The state after which every step stops: towards the safe command, or stay; only a new `init` releases it."""
        return replace(state, ladder=self._ladder.halt(cause))

    def step(self, state: GuardedState[M], y: float, reference: Vec) -> tuple[Command, GuardedState[M]]:
        """One sample; see `Controller.step`. Any `y` and any `reference` are answered."""
        watch = Stopwatch()
        estimate = self._observer.correct(state.estimate, y)
        watch.lap("estimate")
        present = GuardedState(estimate, state.memory, state.ladder, state.due)  # `replace` takes ten times as long
        rung, decided = self._decide(present, reference, watch)
        u = self._limits.clip(rung.u, estimate.command, self._dt)
        after, fault = attempt(lambda: self._observer.advance(estimate, u))
        if after is None:
            after = self._observer.coast(estimate, u)
        watch.lap("advance")
        command = Command(
            u=u,
            source=rung.source,
            status=self._status(rung.status, estimate, fault),
            plan=rung.plan,
            predicted=self._predicted(after, rung),
            disturbance=after.disturbance,
            timing=Timing(watch.stages),
        )
        return command, GuardedState(after, decided.memory, decided.ladder, decided.due)

    def _decide(self, state: GuardedState[M], reference: object, watch: Stopwatch) -> tuple[Rung, GuardedState[M]]:
        """The rung to stand on; the state with the law's memory, the ladder and the next due angle renewed."""
        ladder, missing = state.ladder, state.estimate.missing
        waiting = self._situation(state, np.full(self.horizon, state.due))
        if ladder.stopped:
            return self._ladder.stop(waiting, f"latched {ladder.cause}"), state
        try:
            wanted = usable_reference(reference, self.horizon)
        except UnusableReferenceError as error:
            rung, ladder = self._ladder.pause(ladder, waiting, str(error))
            return rung, replace(state, ladder=ladder)
        situation = self._situation(state, wanted)
        state = GuardedState(state.estimate, state.memory, ladder, situation.setpoint)
        if missing > self._max_missing:
            reason = f"no usable measurement for {missing} samples"
            rung, ladder = self._ladder.descend(ladder, situation, reason, blind=True)
            return rung, replace(state, ladder=ladder)
        proposal, reason = self._proposal(state, situation, watch)
        if proposal is None:
            rung, ladder = self._ladder.descend(ladder, situation, reason)
            watch.lap("fallback")
            return rung, replace(state, ladder=ladder)
        rung = Rung(proposal.u, self._law.source, proposal.status, proposal.plan, proposal.predicted)
        ladder = self._ladder.rise(proposal.plan, proposal.predicted)
        return rung, GuardedState(state.estimate, proposal.memory, ladder, state.due)

    def _proposal(
        self, state: GuardedState[M], situation: Situation, watch: Stopwatch
    ) -> tuple[Proposal[M] | None, str]:
        """The law's proposal, or None and why there is none."""
        if state.estimate.stalled:
            return None, f"the model state is {state.estimate.stalled} samples old"
        proposal, reason = attempt(lambda: self._law.propose(state.memory, situation, watch))
        watch.lap("law")
        if proposal is not None and not math.isfinite(proposal.u):
            return None, f"the law answers {proposal.u}"
        return proposal, reason

    def _situation(self, state: GuardedState[M], wanted: Vec) -> Situation:
        estimate = state.estimate
        return Situation(
            state=estimate.state,
            disturbance=estimate.disturbance,
            disturbance_sigma=math.sqrt(estimate.variance),
            measured=estimate.measured,
            u_last=estimate.command,
            due=state.due,
            setpoint=float(wanted[0]),
            reference=wanted[self._observer.delay_samples :],
            remaining_plan=state.ladder.plan,
        )

    @staticmethod
    def _predicted(after: Estimate, rung: Rung) -> Vec:
        """Angles at the ends of this and the next samples: those under way, then those of the plan."""
        if not after.angles:
            return EMPTY
        under_way = np.asarray(after.angles)
        if not rung.predicted.size:
            return under_way + after.disturbance
        return np.concatenate([under_way[:-1], rung.predicted])[: rung.predicted.size] + after.disturbance

    @staticmethod
    def _status(status: str, estimate: Estimate, fault: str) -> str:
        notes = [] if status == "ok" else [status]
        if estimate.missing:
            notes.append(f"measurement missing or outlying for {estimate.missing} samples, predicted")
        if fault:
            notes.append(f"model state not advanced: {fault}")
        return "; ".join(notes) or "ok"
