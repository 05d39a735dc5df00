"""Controllers, estimator and the closed loop.

A controller is a law (`feedback`: PID, inverse feedforward; `mpc`: predictive, with the planner of `linearised` or
`sampling`) inside `guarded.GuardedController`, which adds estimate, fallbacks and hard limits. `build_controller` makes
one from settings, `run_loop` runs it. `TipController` is all of it behind the few calls that a planner makes.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .build import build_controller as build_controller
    from .command import Command as Command
    from .command import ControlInput as ControlInput
    from .command import Source as Source
    from .command import Stopwatch as Stopwatch
    from .command import Timing as Timing
    from .config import CONTROLLERS as CONTROLLERS
    from .config import parse_controller as parse_controller
    from .feedback.inverse_settings import InverseControllerSettings as InverseControllerSettings
    from .feedback.inverse_settings import InversePidControllerSettings as InversePidControllerSettings
    from .feedback.pid import PidControllerSettings as PidControllerSettings
    from .law import Law as Law
    from .law import Proposal as Proposal
    from .limits import CommandLimits as CommandLimits
    from .loop import Controller as Controller
    from .loop import Plant as Plant
    from .loop import run_loop as run_loop
    from .mpc_settings import LinearisedMpcSettings as LinearisedMpcSettings
    from .mpc_settings import SamplingMpcSettings as SamplingMpcSettings
    from .planner.tip_controller import TipController as TipController

# Imported when first asked for: a controller loads CasADi, numba and onnxruntime, which take over a second.
_HOMES = {
    "build": ("build_controller",),
    "command": ("Command", "ControlInput", "Source", "Stopwatch", "Timing"),
    "config": ("CONTROLLERS", "parse_controller"),
    "feedback.inverse_settings": ("InverseControllerSettings", "InversePidControllerSettings"),
    "feedback.pid": ("PidControllerSettings",),
    "law": ("Law", "Proposal"),
    "limits": ("CommandLimits",),
    "loop": ("Controller", "Plant", "run_loop"),
    "mpc_settings": ("LinearisedMpcSettings", "SamplingMpcSettings"),
    "planner.tip_controller": ("TipController",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name, from the module in which it is defined."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(_HOME)
