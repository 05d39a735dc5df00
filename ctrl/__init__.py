"""Controllers, estimators and the closed loop.

A controller is a law (`feedback`: PID, inverse feedforward; `mpc`: predictive, with the planner of `linearised` or
`sampling`) inside `guarded.GuardedController`, which adds estimate, fallbacks and hard limits. `build_controller` makes
one from settings, `run_loop` runs it. `TipController` is the interface for motion planners.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .build import build_controller
    from .command import Command, CommandLimits, ControlInput, Source, Stopwatch, Timing
    from .config import CONTROLLERS, parse_controller
    from .estimation.observer import EstimatorSettings
    from .feedback import InverseControllerSettings, InversePidControllerSettings, PidControllerSettings
    from .law import Law, LawSettings, Proposal
    from .loop import Controller, Plant, run_loop
    from .mpc_settings import LinearisedMpcSettings, SamplingMpcSettings
    from .planner.tip_controller import TipController

__all__ = [
    "CONTROLLERS",
    "Command",
    "CommandLimits",
    "ControlInput",
    "Controller",
    "EstimatorSettings",
    "InverseControllerSettings",
    "InversePidControllerSettings",
    "Law",
    "LawSettings",
    "LinearisedMpcSettings",
    "PidControllerSettings",
    "Plant",
    "Proposal",
    "SamplingMpcSettings",
    "Source",
    "Stopwatch",
    "Timing",
    "TipController",
    "build_controller",
    "parse_controller",
    "run_loop",
]

# Imported when first asked for: a controller loads CasADi and onnxruntime, which takes long.
if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.ctrl.command", "Command CommandLimits ControlInput Source Stopwatch Timing"),
        ("hystmpc.ctrl.config", "CONTROLLERS parse_controller"),
        ("hystmpc.ctrl.estimation.observer", "EstimatorSettings"),
        ("hystmpc.ctrl.feedback", "PidControllerSettings"),
        ("hystmpc.ctrl.build", "build_controller"),
        ("hystmpc.ctrl.feedback", "InverseControllerSettings InversePidControllerSettings"),
        ("hystmpc.ctrl.law", "Law LawSettings Proposal"),
        ("hystmpc.ctrl.loop", "Controller Plant run_loop"),
        ("hystmpc.ctrl.mpc_settings", "LinearisedMpcSettings SamplingMpcSettings"),
        ("hystmpc.ctrl.planner.tip_controller", "TipController"),
    )
