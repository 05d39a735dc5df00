"""What to do when a controller fails: shifted plan, inverse, hold, stop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar, final

import numpy as np

from hystmpc.models.model import Inverse
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import EMPTY, Source
from .law import Situation
from .limits import CommandLimits

T = TypeVar("T")


def attempt(action: Callable[[], T]) -> tuple[T | None, str]:
    """Result of `action`, or None and one line on what it raised; floating-point faults stay silent NaNs."""
    try:
        with np.errstate(all="ignore"):
            return action(), ""
    except Exception as error:  # noqa: BLE001 - models and solvers may raise anything, the loop must go on
        text = " ".join(str(error).split())
        return None, f"{type(error).__name__}: {text}"[:200]


@dataclass(frozen=True)
class LadderOptions:
    """When to give up, and where to go then.

    Attributes:
        stop_after_failures: consecutive failed samples after which the stop is latched.
        safe_command: where a stop goes, within the rate limit [mm or bar]; None stays at the last command.

    Raises:
        ControllerError: if the count is not positive or the command is not finite.
    """

    stop_after_failures: int = 25
    safe_command: float | None = None

    def __post_init__(self) -> None:
        safe = self.safe_command
        if self.stop_after_failures < 1 or not (safe is None or math.isfinite(safe)):
            raise ControllerError(
                f"ladder: got stop_after_failures {self.stop_after_failures}, safe_command {safe}, "
                "expected at least 1 and a finite command or none"
            )


@dataclass(frozen=True, eq=False)
class LadderState:
    """Counters and what is left of the last good plan.

    Attributes:
        failures: consecutive failed samples.
        stopped: whether the stop is latched; only a new `init` releases it.
        plan: remaining planned commands.
        predicted: the angles that belong to them [deg], without disturbance.
        cause: why the stop is latched.
    """

    failures: int = 0
    stopped: bool = False
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    cause: str = "after repeated failures"


@dataclass(frozen=True, eq=False)
class Rung:
    """The rung stood on: a finite command, not yet limited, and the plan behind it if there is one."""

    u: float
    source: Source
    status: str
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)


@final
class Ladder:
    """Chooses the rung; `rise` after a success, `descend` after a failure, `pause` where there is nothing to follow.

    Raises:
        ControllerError: if the safe command lies beyond the limits.
    """

    def __init__(self, limits: CommandLimits, options: LadderOptions, inverse: Inverse | None) -> None:
        safe = options.safe_command
        if safe is not None and not limits.lower <= safe <= limits.upper:
            raise ControllerError(
                f"ladder: got safe_command {safe}, expected one within {limits.lower} to {limits.upper}"
            )
        self._options = options
        self._inverse = inverse

    def rise(self, plan: Vec, predicted: Vec) -> LadderState:
        """State after a success: counters at zero, the plan shifted by the sample that is being sent."""
        return LadderState(plan=plan[1:], predicted=predicted[1:])

    def pause(self, state: LadderState, situation: Situation, reason: str) -> tuple[Rung, LadderState]:
        """Hold because there is nothing to follow; not a failure, and the old plan is void."""
        return Rung(situation.u_last, Source.HOLD, reason), replace(state, plan=EMPTY, predicted=EMPTY)

    def descend(
        self, state: LadderState, situation: Situation, reason: str, blind: bool = False
    ) -> tuple[Rung, LadderState]:
        """The best rung left after a failure.

        Args:
            state: counters and remaining plan.
            situation: what the controller saw.
            reason: one line on what failed.
            blind: the measurement has been missing for too long; plans are no longer to be trusted: hold.
        """
        state = replace(state, failures=state.failures + 1)
        if state.failures >= self._options.stop_after_failures:
            state = replace(state, stopped=True)
            return self.stop(situation, reason), state
        if blind:
            return self.pause(state, situation, reason)
        if state.plan.size:
            rung = Rung(float(state.plan[0]), Source.SHIFTED_PLAN, reason, state.plan, state.predicted)
            return rung, replace(state, plan=state.plan[1:], predicted=state.predicted[1:])
        u, more = self._inverse_command(situation)
        if u is not None:
            return Rung(u, Source.INVERSE, reason), state
        return Rung(situation.u_last, Source.HOLD, f"{reason}; {more}" if more else reason), state

    def halt(self, cause: str) -> LadderState:
        """The latched state of a stop that was asked for."""
        return LadderState(stopped=True, cause=cause)

    def stop(self, situation: Situation, reason: str) -> Rung:
        """The last rung: towards the safe command, or stay."""
        safe = self._options.safe_command
        return Rung(situation.u_last if safe is None else safe, Source.STOP, f"stopped: {reason}")

    def _inverse_command(self, situation: Situation) -> tuple[float | None, str]:
        if self._inverse is None:
            return None, ""
        inverse, wanted = self._inverse, float(situation.reference[0] - situation.disturbance)
        u, reason = attempt(lambda: float(inverse.command(situation.state, wanted, situation.u_last)))
        if u is None:
            return None, reason
        return (u, "") if math.isfinite(u) else (None, f"the inverse answers {u}")
