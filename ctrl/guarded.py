"""Guarded controller: a control law inside an estimator, a chain of fallback levels and hard limits."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar, Generic, TypeVar, final

import numpy as np

from hystmpc.models.model import Inverse
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.config import Count, NotNegativeInt, Settings
from hystmpc.trials.errors import ControllerError, HystmpcError, shown
from hystmpc.trials.types import Index, Vec

from .command import (
    EMPTY,
    Command,
    CommandLimits,
    ControlInput,
    LimitsSettings,
    Source,
    Stopwatch,
    Timing,
    attempt,
    number_of,
    numbers_of,
    replace,
)
from .estimation.observer import ANGLE_BOUND_DEG, Estimate, Observer, SensorKindSettings, usable_angle

_ROUNDING = 1e-6  # of a sample

M = TypeVar("M")
N = TypeVar("N")


@dataclass(frozen=True, eq=False)
class Proposal(Generic[M]):
    """Proposed command, next memory, plan (`predicted` without disturbance) and level; None for the law's level."""

    u: float
    memory: M
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    status: str = "ok"
    source: Source | None = None


class Law(ABC, Generic[M]):
    """Control law with explicit memory; it may raise, and propose commands beyond the limits."""

    horizon: int  # reference samples that the law uses
    source: Source

    @abstractmethod
    def init(self, y: float, u: float) -> M:
        """Return the memory at rest with measured angle `y` [deg] and held command `u`."""

    @abstractmethod
    def propose(self, memory: M, given: ControlInput, watch: Stopwatch) -> Proposal[M]:
        """Propose a command; the time of each stage is recorded in `watch`."""


class FallbackSettings(Settings):
    """Block `ladder`: conditions for prediction, fallback and stop.

    Attributes:
        stop_after_failures: consecutive failed samples after which the stop is latched.
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.
        safe_command: where a stop goes, within the rate limit [mm or bar]; null stays at the last command.
    """

    stop_after_failures: Count = 25
    max_missing_samples: NotNegativeInt = 25
    safe_command: float | None = None


class LawSettings(Settings):
    """Base class of the settings of every kind of controller.

    An external class builds its parts itself. It defines

        law(predictor, inverse, limits) -> Law
        observer(predictor) -> Observer
        model_pair(predictor, inverse) -> (predictor, inverse), where it does not work with these two as they are

    Attributes:
        limits: may only narrow those of the device; null takes them as they are.
        ladder: when prediction, fallback and stop set in.
        estimator: how the measurements come.
    """

    falls_back_on_inverse: ClassVar[bool] = True
    predicts: ClassVar[bool] = (
        False  # whether the law predicts with the model itself; others get an operator in place of a network
    )

    limits: LimitsSettings | None = None
    ladder: FallbackSettings = FallbackSettings()
    estimator: SensorKindSettings = SensorKindSettings()

    def resolved(self) -> LawSettings:
        """Return these settings, or those of the external class that they name."""
        return self

    def bridged_samples(self, dt_s: float) -> int:
        """Number of consecutive samples without a usable measurement that are bridged, at sample time `dt_s` [s]."""
        usual = self.ladder.max_missing_samples
        return usual if hasattr(self, "law") else self.estimator.bridged_samples(usual, dt_s)


@dataclass(frozen=True, eq=False)
class GuardedState(Generic[M]):
    """Complete state of a controller, which serves as its snapshot."""

    estimate: Estimate  # observer snapshot, with the command really sent last
    memory: M  # memory of the law
    fallback: FallbackState  # failure counters and remaining plan
    due: float  # reference angle at the present instant [deg]
    __repr__ = brief


@final
class GuardedController(Generic[M]):
    """Controller around a control law: its step never raises, and its commands never leave the limits.

    Order of one step: correct the estimate with the measurement, check the reference, let the law propose, take the
    proposal or a fallback, limit from the command really sent, advance the model with the result.

    Args:
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.

    Raises:
        ControllerError: if `dt` is not above zero or `max_missing_samples` is negative.
    """

    def __init__(
        self,
        law: Law[M],
        observer: Observer,
        fallback: FallbackChain,
        limits: CommandLimits,
        dt: float,
        max_missing_samples: int = 25,
    ) -> None:
        if not (math.isfinite(dt) and dt > 0) or max_missing_samples < 0:
            raise ControllerError(
                f"controller: got dt {dt}, max_missing_samples {max_missing_samples}, expected > 0 s and >= 0"
            )
        self._law, self._observer, self._fallback, self._limits = law, observer, fallback, limits
        self._dt = dt
        self._max_missing = max_missing_samples

    def __repr__(self) -> str:
        return in_brief(self, f"{type(self._law).__name__}, {self._limits}, every {self._dt:.4g} s")

    @property
    def law(self) -> Law[M]:
        """Control law inside the estimator and the fallbacks."""
        return self._law

    @property
    def limits(self) -> CommandLimits:
        """Hard limits of every command."""
        return self._limits

    def with_law(self, law: Law[N]) -> GuardedController[N]:
        """Return a controller with the same estimator, fallbacks and limits around another law."""
        return GuardedController(law, self._observer, self._fallback, self._limits, self._dt, self._max_missing)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._dt

    @property
    def horizon(self) -> int:
        """Number of reference samples that `step` uses: those of the law and those that pass before a command acts."""
        return self._law.horizon + self._observer.delay_samples

    def init(self, y: float, u: float) -> GuardedState[M]:
        """Return the state at rest.

        Raises:
            ControllerError: if `y` or `u` is not finite, `u` is beyond the limits, or the model fails at rest.
        """
        low, high = self._limits.lower, self._limits.upper
        angle, held = usable_angle(y), number_of(u)
        if not (math.isfinite(angle) and held is not None and low <= held <= high):
            raise ControllerError(
                f"controller: got a start at {shown(y, 50)} deg with command {shown(u, 50)}, expected a finite angle "
                f"within {ANGLE_BOUND_DEG:.0f} deg and a command within {low} to {high}"
            )
        try:
            estimate, memory = self._observer.init(angle, held), self._law.init(angle, held)
            return GuardedState(estimate, memory, FallbackState(), angle)
        except HystmpcError:
            raise
        except Exception as error:
            raise ControllerError(
                f"controller: the model fails at rest ({angle} deg, command {held}): {error}"
            ) from error

    def replay(self, commands: Vec, angles: Vec) -> GuardedState[M]:
        """Return the state after a recording, as if the controller itself had sent its commands.

        Args:
            commands: sent last (T,) [mm or bar], the newest at the end.
            angles: measured when each was sent (T,) [deg]; not-a-number where there was none. The device is assumed to
                rest at the first usable one, under the command sent before it, or then where it is the first.

        Raises:
            ControllerError: as `usable_in`, or if the model fails.
        """
        usable = self.usable_in(commands, angles)
        first = int(usable[0])
        state = self.init(float(angles[first]), float(commands[max(first - 1, 0)]))
        estimate, last = state.estimate, float(angles[usable[-1]])
        for y, u in zip(angles[first:].tolist(), commands[first:].tolist(), strict=True):
            after, fault = attempt(partial(self._observer.advance, self._observer.correct(estimate, y), u))
            if after is None:
                raise ControllerError(f"replay: the model fails at command {u}: {fault}")
            estimate = after
        return replace(state, estimate=estimate, memory=self._law.init(last, estimate.command), due=last)

    def usable_in(self, commands: Vec, angles: Vec) -> Index:
        """Return the samples of a recording whose angle is usable, at least one.

        Raises:
            ControllerError: if no angle is usable, the lengths differ, or a command is beyond the limits.
        """
        usable = np.flatnonzero([math.isfinite(usable_angle(y)) for y in angles])
        low, high = self._limits.lower, self._limits.upper
        if commands.shape != angles.shape or not usable.size or not np.all((commands >= low) & (commands <= high)):
            raise ControllerError(
                f"replay: got {commands.size} commands and {angles.size} angles, {usable.size} of them usable, "
                f"expected as many commands within {low} to {high} as angles, at least one of them usable"
            )
        return usable

    def sigma_deg(self, state: GuardedState[M]) -> float:
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        return self._observer.sigma_deg(state.estimate)

    def sigma_ahead_deg(self, state: GuardedState[M], commands: Vec) -> Vec:
        """Standard deviation of the error of the angles predicted under the coming commands (H,) [deg]."""
        estimate = state.estimate
        travels = np.concatenate([estimate.moves[1:], np.abs(np.diff(commands, prepend=estimate.command))])
        return self._observer.sigma_ahead_deg(estimate, travels[: commands.size])

    def measure(self, state: GuardedState[M], y: float, age: float) -> GuardedState[M]:
        """Measurement update with `y` [deg], taken `age` samples before the next step.

        Raises:
            ControllerError: if the estimator accepts no late measurements, or none of that age; or the model fails.
        """
        age = 0.0 if -_ROUNDING < age < 0.0 else age
        estimate, fault = attempt(lambda: self._observer.correct_late(state.estimate, y, age))
        if estimate is None:
            raise ControllerError(fault.removeprefix("ControllerError: "))
        return replace(state, estimate=estimate)

    def stop(self, state: GuardedState[M], cause: str) -> GuardedState[M]:
        """Return the state with the stop latched: steps go to the safe command or hold, until a new `init`."""
        return replace(state, fallback=self._fallback.halt(cause))

    def step(self, state: GuardedState[M], y: float, reference: Vec) -> tuple[Command, GuardedState[M]]:
        """Compute the command of one sample, for any `y` and any `reference`; see `Controller.step`."""
        watch = Stopwatch()
        estimate = self._observer.correct(state.estimate, y)
        watch.lap("estimate")
        level, decided = self._decide(replace(state, estimate=estimate), reference, watch)
        u = self._limits.clip(level.u, estimate.command, self._dt)
        after, fault = attempt(lambda: self._observer.advance(estimate, u))
        if after is None:
            after = self._observer.coast(estimate, u)
        watch.lap("advance")
        command = Command(
            u=u,
            source=level.source,
            status=self._status(level.status, estimate, fault),
            plan=level.plan,
            predicted=self._predicted(after, level),
            disturbance=after.departure,
            timing=Timing(watch.stages),
        )
        return command, replace(decided, estimate=after)

    def _decide(self, state: GuardedState[M], reference: object, watch: Stopwatch) -> tuple[Level, GuardedState[M]]:
        """Fallback level, and the state with new memory of the law, fallback state and due angle."""
        fallback, missing = state.fallback, state.estimate.missing
        if fallback.stopped:
            return self._fallback.stop(self._waiting(state), f"latched {fallback.cause}"), state
        try:
            wanted = usable_reference(reference, self.horizon)
        except UnusableReferenceError as error:
            level, fallback = self._fallback.pause(fallback, self._waiting(state), str(error))
            return level, replace(state, fallback=fallback)
        given = self._input(state, wanted)
        state = replace(state, due=given.setpoint)
        if missing > self._max_missing:
            reason = f"no usable measurement for {missing} samples"
            level, fallback = self._fallback.on_failure(fallback, given, reason, blind=True)
            return level, replace(state, fallback=fallback)
        proposal, reason = self._proposal(state, given, watch)
        if proposal is None:
            level, fallback = self._fallback.on_failure(fallback, given, reason)
            watch.lap("fallback")
            return level, replace(state, fallback=fallback)
        level = Level(
            proposal.u, proposal.source or self._law.source, proposal.status, proposal.plan, proposal.predicted
        )
        fallback = self._fallback.on_success(proposal.plan, proposal.predicted)
        return level, replace(state, memory=proposal.memory, fallback=fallback)

    def _proposal(
        self, state: GuardedState[M], given: ControlInput, watch: Stopwatch
    ) -> tuple[Proposal[M] | None, str]:
        """Proposal of the law, or None and the reason why it failed."""
        if state.estimate.stalled:
            return None, f"the model state is {state.estimate.stalled} samples old"
        proposal, reason = attempt(lambda: self._law.propose(state.memory, given, watch))
        watch.lap("law")
        if proposal is not None and not math.isfinite(proposal.u):
            return None, f"the law answers {proposal.u}"
        return proposal, reason

    def _waiting(self, state: GuardedState[M]) -> ControlInput:
        """Inputs without a usable reference: the due angle is held."""
        return self._input(state, np.full(self.horizon, state.due))

    def _input(self, state: GuardedState[M], wanted: Vec) -> ControlInput:
        estimate = state.estimate
        return ControlInput(
            state=estimate.state,
            disturbance=estimate.disturbance,
            disturbance_sigma=self._observer.disturbance_sigma_deg(estimate),
            forecast_error=estimate.forecast_error,
            measured=estimate.measured,
            age=estimate.age,
            u_last=estimate.command,
            due=state.due,
            setpoint=float(wanted[0]),
            reference=wanted[self._observer.delay_samples :],
            remaining_plan=state.fallback.plan,
        )

    @staticmethod
    def _predicted(after: Estimate, level: Level) -> Vec:
        """Angles at the ends of this and the next samples, of commands already sent and of the plan."""
        if not after.angles:
            return EMPTY
        under_way, planned = after.angles, level.predicted
        if not planned.size:
            return np.asarray(under_way) + after.disturbance
        if len(under_way) > 1:
            planned = np.concatenate([under_way[:-1], planned])[: planned.size]
        return planned + after.disturbance

    @staticmethod
    def _status(status: str, estimate: Estimate, fault: str) -> str:
        notes = [] if status == "ok" else [status]
        if estimate.missing:
            notes.append(f"measurement missing or outlying for {estimate.missing} samples, predicted")
        if fault:
            notes.append(f"model state not advanced: {fault}")
        return "; ".join(notes) or "ok"


class UnusableReferenceError(ValueError):
    """Error of a reference that cannot be followed; never leaves the step."""


def usable_reference(reference: object, horizon: int) -> Vec:
    """Return the first `horizon` reference angles [deg].

    Raises:
        UnusableReferenceError: if it is not a vector of numbers, is too short, or holds a NaN or an absurd angle.
    """
    wanted = numbers_of(reference)
    if wanted.ndim != 1 or wanted.shape[0] < horizon:
        raise UnusableReferenceError(f"reference: got shape {wanted.shape}, expected ({horizon},)")
    wanted = wanted[:horizon]
    if not np.abs(wanted).max() <= ANGLE_BOUND_DEG:  # or not a number
        raise UnusableReferenceError(f"reference: not finite or beyond {ANGLE_BOUND_DEG:.0f} deg")
    return wanted


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class FallbackState:
    """Failure counters and the remaining commands of the last good plan."""

    failures: int = 0  # consecutive failed samples
    stopped: bool = False  # whether the stop is latched; only a new `init` releases it
    plan: Vec = field(default_factory=lambda: EMPTY)  # remaining planned commands
    predicted: Vec = field(default_factory=lambda: EMPTY)  # the angles that belong to them [deg], without disturbance
    cause: str = "after repeated failures"  # why the stop is latched


@dataclass(frozen=True, eq=False)
class Level:
    """Fallback level: a finite command, not yet limited, and the plan behind it if there is one."""

    u: float
    source: Source
    status: str
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)


@final
class FallbackChain:
    """Chain of fallback levels: shifted plan, inverse, hold, stop.

    Raises:
        ControllerError: if the safe command lies beyond the limits.
    """

    def __init__(self, limits: CommandLimits, settings: FallbackSettings, inverse: Inverse | None) -> None:
        safe = settings.safe_command
        if safe is not None and not limits.lower <= safe <= limits.upper:
            raise ControllerError(
                f"ladder: got safe_command {safe}, expected one within {limits.lower} to {limits.upper}"
            )
        self._settings = settings
        self._inverse = inverse

    def on_success(self, plan: Vec, predicted: Vec) -> FallbackState:
        """Return the state after a success: counters at zero, the plan shifted by the sample that is being sent."""
        return FallbackState(plan=plan[1:], predicted=predicted[1:])

    def pause(self, state: FallbackState, given: ControlInput, reason: str) -> tuple[Level, FallbackState]:
        """Hold without a usable reference, which is no failure; the old plan is discarded."""
        return Level(given.u_last, Source.HOLD, reason), replace(state, plan=EMPTY, predicted=EMPTY)

    def on_failure(
        self, state: FallbackState, given: ControlInput, reason: str, blind: bool = False
    ) -> tuple[Level, FallbackState]:
        """Return the best remaining level after a failure.

        Args:
            blind: whether the measurement has been missing for too long for plans to be reliable.
        """
        state = replace(state, failures=state.failures + 1)
        if state.failures >= self._settings.stop_after_failures:
            state = replace(state, stopped=True)
            return self.stop(given, reason), state
        if blind:
            return self.pause(state, given, reason)
        if state.plan.size:
            level = Level(float(state.plan[0]), Source.SHIFTED_PLAN, reason, state.plan, state.predicted)
            return level, replace(state, plan=state.plan[1:], predicted=state.predicted[1:])
        u, more = self._inverse_command(given)
        if u is not None:
            return Level(u, Source.INVERSE, reason), state
        return Level(given.u_last, Source.HOLD, f"{reason}; {more}" if more else reason), state

    def halt(self, cause: str) -> FallbackState:
        """Return the latched state after a requested stop."""
        return FallbackState(stopped=True, cause=cause)

    def stop(self, given: ControlInput, reason: str) -> Level:
        """Stop, the last level: ramp to the safe command, or hold."""
        safe = self._settings.safe_command
        return Level(given.u_last if safe is None else safe, Source.STOP, f"stopped: {reason}")

    def _inverse_command(self, given: ControlInput) -> tuple[float | None, str]:
        if self._inverse is None:
            return None, ""
        inverse, wanted = self._inverse, float(given.reference[0] - given.disturbance)
        u, reason = attempt(lambda: float(inverse.command(given.state, wanted, given.u_last)))
        if u is None:
            return None, reason
        return (u, "") if math.isfinite(u) else (None, f"the inverse answers {u}")
