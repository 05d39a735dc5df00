"""Closed loop in simulation: plants with injectable effects, studies, tuning, metrics, reports.

A study is a `config.SimulationConfig`; `study.prepare` makes it ready, `compare.compare` runs every controller along
every motion and leaves a run folder, `report.report_from_folder` writes its page anew. `demo.demo` is one that ships
with the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .config import SimulationConfig
    from .devices.dataset_files import read_dataset, write_dataset
    from .devices.make import make_dataset
    from .devices.rod_parameters import RodParameters
    from .devices.rod_trials import simulate_rod
    from .environment.gym_ import Disturbance, EnvironmentState, HysteresisEnv
    from .plant import Effects, SimulatedPlant

__all__ = [
    "Disturbance",
    "Effects",
    "EnvironmentState",
    "HysteresisEnv",
    "RodParameters",
    "SimulatedPlant",
    "SimulationConfig",
    "make_dataset",
    "read_dataset",
    "simulate_rod",
    "write_dataset",
]

if not TYPE_CHECKING:  # the environment needs gymnasium, an extra
    __getattr__ = lazily(
        __name__,
        ("hystmpc.sim.config", "SimulationConfig"),
        ("hystmpc.sim.devices.dataset_files", "read_dataset write_dataset"),
        ("hystmpc.sim.devices.make", "make_dataset"),
        ("hystmpc.sim.devices.rod_parameters", "RodParameters"),
        ("hystmpc.sim.devices.rod_trials", "simulate_rod"),
        ("hystmpc.sim.environment.gym_", "Disturbance EnvironmentState HysteresisEnv"),
        ("hystmpc.sim.plant", "Effects SimulatedPlant"),
    )
