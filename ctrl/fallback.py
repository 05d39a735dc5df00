"""What to do when a controller fails: shifted plan, inverse, hold, stop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar, final

import numpy as np

from hystmpc.models.model import Inverse
from hystmpc.trials.config import Count, NotNegativeInt, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import EMPTY, ControlInput, Source
from .frozen import replace
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


class FallbackSettings(Settings):
    """Block `ladder`: when prediction, fallback and stop set in.

    Attributes:
        stop_after_failures: consecutive failed samples after which the stop is latched.
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.
        safe_command: where a stop goes, within the rate limit [mm or bar]; null stays at the last command.
    """

    stop_after_failures: Count = 25
    max_missing_samples: NotNegativeInt = 25
    safe_command: float | None = None


@dataclass(frozen=True, eq=False)
class FallbackState:
    """Counters and what is left of the last good plan."""

    failures: int = 0  # consecutive failed samples
    stopped: bool = False  # whether the stop is latched; only a new `init` releases it
    plan: Vec = field(default_factory=lambda: EMPTY)  # remaining planned commands
    predicted: Vec = field(default_factory=lambda: EMPTY)  # the angles that belong to them [deg], without disturbance
    cause: str = "after repeated failures"  # why the stop is latched


@dataclass(frozen=True, eq=False)
class Level:
    """One level of fallback: a finite command, not yet limited, and the plan behind it if there is one."""

    u: float
    source: Source
    status: str
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)


@final
class FallbackChain:
    """Chooses the level of fallback: shifted plan, inverse, hold, stop.

    Args:
        inverse: of the model; None where there is none.

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
        """State after a success: counters at zero, the plan shifted by the sample that is being sent."""
        return FallbackState(plan=plan[1:], predicted=predicted[1:])

    def pause(self, state: FallbackState, given: ControlInput, reason: str) -> tuple[Level, FallbackState]:
        """Hold because there is nothing to follow; not a failure; the old plan is dropped."""
        return Level(given.u_last, Source.HOLD, reason), replace(state, plan=EMPTY, predicted=EMPTY)

    def on_failure(
        self, state: FallbackState, given: ControlInput, reason: str, blind: bool = False
    ) -> tuple[Level, FallbackState]:
        """The best level left after a failure.

        Args:
            blind: the measurement has been missing for too long; plans are no longer to be trusted: hold.
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
        """The latched state of a stop that was asked for."""
        return FallbackState(stopped=True, cause=cause)

    def stop(self, given: ControlInput, reason: str) -> Level:
        """The last level: towards the safe command, or stay."""
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
