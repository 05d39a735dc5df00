"""One controller on one simulated plant along one motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hystmpc.ctrl.loop import (
    AnySensorSettings,
    ContinuousSensorSettings,
    Controller,
    LoopLog,
    LoopSample,
    Viewer,
    run_loop,
)
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trials.brief import brief
from hystmpc.trials.types import Vec

from .plants.computed import ComputedPlant


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """Signals of one closed-loop run.

    Attributes:
        log: the loop's own log, with measured angles, N samples.
        true_deg: angles without sensor noise at the ends of the samples (N,) [deg].
        rest_command: the command that the plant held before the first sample.
        dt: sample time [s].
        first: number of the first sample that counts: before it the reference leads from the rest to its start.
    """

    log: LoopLog
    true_deg: Vec
    rest_command: float
    dt: float
    unit: str
    first: int = 0
    __repr__ = brief

    @property
    def error_deg(self) -> Vec:
        """True angle less reference (N,) [deg]."""
        return self.true_deg - self.log.reference_deg

    @property
    def counted_deg(self) -> Vec:
        """The part of `error_deg` that counts [deg]."""
        return self.error_deg[self.first :]


def run_closed_loop(
    controller: Controller[Any],
    plant: ComputedPlant,
    motion: Trajectory,
    on_sample: Callable[[LoopSample], None] | None = None,
    sensor: AnySensorSettings | None = None,
    approach_s: float = 0.0,
) -> ClosedLoopRun:
    """Follow a motion once from the plant's rest, as fast as it computes.

    Args:
        approach_s: time at the motion's beginning that does not count, a whole number of samples [s].
        sensor: what the controller sees; the plant's own angle in every sample where left out. The frames of an imaging
            system show the true angle with their own noise, drawn from the plant's seed; without a sensor the true
            angle of the rest is declared.

    Raises:
        ControllerError: if controller and plant differ in sample time, or the controller cannot start from the rest.
    """
    preview = PreviewTable(motion, plant.dt, controller.horizon)
    angles: list[float] = []

    def note(sample: LoopSample) -> None:
        angles.append(plant.true_angle)
        if on_sample is not None:
            on_sample(sample)

    viewer = None
    if not (sensor is None or isinstance(sensor, ContinuousSensorSettings)):
        viewer = Viewer(sensor, plant.seed, lambda: plant.true_angle)
    rest = plant.rest_command
    log = run_loop(controller, plant, preview.at, preview.steps, u_start=rest, on_sample=note, viewer=viewer)
    first = round(approach_s / plant.dt)
    return ClosedLoopRun(log, np.array(angles), plant.rest_command, plant.dt, plant.command_unit, first)
