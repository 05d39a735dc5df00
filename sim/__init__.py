"""Closed-loop simulation: plants with additional effects, sweeps, tuning, metrics and reports.

A study is a `config.SimulationConfig`; `study.prepare` opens and builds its parts; `compare.compare` runs every
controller along every motion and writes a run folder; `compare.demo` runs the study in the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .config import SimulationConfig
    from .gym_ import Disturbance, EnvironmentState, HysteresisEnv
    from .plants.simulated import Effects, SimulatedPlant
    from .study import run_closed_loop

__all__ = [
    "Disturbance",
    "Effects",
    "EnvironmentState",
    "HysteresisEnv",
    "SimulatedPlant",
    "SimulationConfig",
    "run_closed_loop",
]

if not TYPE_CHECKING:  # the environment needs gymnasium, an extra
    __getattr__ = lazily(
        __name__,
        ("hystmpc.sim.study", "run_closed_loop"),
        ("hystmpc.sim.config", "SimulationConfig"),
        ("hystmpc.sim.gym_", "Disturbance EnvironmentState HysteresisEnv"),
        ("hystmpc.sim.plants.simulated", "Effects SimulatedPlant"),
    )
