"""Closed loop in simulation: plants with injectable effects, sweeps, tuning, metrics, reports.

A study is a `config.SimulationConfig`; `study.prepare` makes it ready, `compare.compare` runs every controller along
every motion and leaves a run folder, `compare.report_from_folder` writes its page anew. `compare.demo` runs the study
that ships with the package.
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
