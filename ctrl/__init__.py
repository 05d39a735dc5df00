"""Controllers, estimator and the closed loop.

A controller is a law (`law.py`: inverse feedforward, PID, inverse with PID, predictive) inside
`guarded.GuardedController`, which adds estimate, fallback ladder and hard limits. The predictive law
(`mpc.py`) takes either planner: `linearised` or `sampling`. `build.build_controller` makes one from settings,
`loop.run_loop` runs it. `tip_controller.TipController` is all of it behind the few calls that a planner makes.
"""

from typing import TYPE_CHECKING, Any

from .command import Command, Source, Timing
from .limits import CommandLimits
from .loop import Controller, Plant

if TYPE_CHECKING:
    from .planner.tip_controller import TipController

__all__ = ["Command", "CommandLimits", "Controller", "Plant", "Source", "Timing", "TipController"]


def __getattr__(name: str) -> Any:
    """`TipController`, imported when first asked for: its settings need pydantic, which a control law does not."""
    if name == "TipController":
        from .planner.tip_controller import TipController

        return TipController
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
