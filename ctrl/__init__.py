"""Controllers, estimator and the closed loop.

A controller is a law (`law.py`: inverse feedforward, PID, inverse with PID, predictive) inside
`guarded.GuardedController`, which adds estimate, fallback ladder and hard limits. The predictive law
(`mpc.py`) takes either planner: `linearised` or `sampling`. `build.build_controller` makes one from settings,
`loop.run_loop` runs it.
"""

from .command import Command, Source, Timing
from .limits import CommandLimits
from .protocols import Controller, Plant

__all__ = ["Command", "CommandLimits", "Controller", "Plant", "Source", "Timing"]
