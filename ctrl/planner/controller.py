"""What a `TipController` needs of the controller that it steps."""

from __future__ import annotations

from typing import Any, Protocol

from hystmpc.trials.types import Vec

from ..guarded import GuardedState
from ..loop import Controller


class PlannersController(Controller[GuardedState[Any]], Protocol):
    """A `GuardedController`, or one that answers as it does, such as its C."""

    def replay(self, commands: Vec, angles: Vec) -> GuardedState[Any]:
        """State after a recording, see `GuardedController.replay`."""
        ...

    def sigma_deg(self, state: GuardedState[Any]) -> float:
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        ...

    def sigma_ahead_deg(self, state: GuardedState[Any], commands: Vec) -> Vec:
        """Standard deviation of the error of the angles predicted for the ends of the coming samples (H,) [deg]."""
        ...

    def stop(self, state: GuardedState[Any], cause: str) -> GuardedState[Any]:
        """The state after which every step stops; only a new `init` releases it."""
        ...
