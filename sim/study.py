"""Closed-loop study: files opened, controllers built, and runs of one controller along one motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import Command, CommandLimits, ModelledLimitsSettings, limits_of_model, modelled_limits
from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.loop import (
    AnySensorSettings,
    ContinuousSensorSettings,
    Controller,
    LoopLog,
    LoopSample,
    Viewer,
    run_loop,
)
from hystmpc.ctrl.planner.reach import angles_at_rest, beyond_reach
from hystmpc.models.contract.metadata import Range
from hystmpc.models.load import model_path
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trajectories.drawn import approached
from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.types import Vec

from .config import SimulationConfig
from .plants.computed import ComputedPlant
from .plants.device import make_plant, plant_files
from .plants.simulated import SimulatedPlant


@dataclass(frozen=True, eq=False)
class Study:
    """Closed-loop study that is ready to run: plant, model, limits, motions."""

    config: SimulationConfig
    plant: ComputedPlant
    model: ControllerModel  # predictors and inverses of the controllers
    limits: CommandLimits
    motions: Mapping[str, Trajectory]  # references, each after an approach where it starts far from the plant's rest
    approach_s: Mapping[str, float]  # duration of each approach, 0 for none [s]; it does not count
    files: tuple[Path, ...]

    def controller(self, settings: AnyControllerSettings) -> GuardedController:
        """Build a controller on this study's model.

        Raises:
            ControllerError: if the settings contradict each other or go beyond the limits.
        """
        return build_controller(settings, *pair_for(settings, self.model), self.limits)

    def run(
        self, settings: AnyControllerSettings, motion: str, on_sample: Callable[[LoopSample], None] | None = None
    ) -> ClosedLoopRun:
        """Run one controller along one motion.

        Raises:
            ControllerError: if the settings contradict each other or go beyond the limits.
            KeyboardInterrupt: if the user ended it, since an unfinished run is no result.
        """
        reference, approach_s = self.motions[motion], self.approach_s[motion]
        run = run_closed_loop(
            self.controller(settings), self.plant, reference, on_sample, self.config.sensor, approach_s
        )
        if run.log.interrupted:
            raise KeyboardInterrupt  # after Ctrl-C the loop itself returns normally
        return run

    def warnings(self) -> tuple[str, ...]:
        """One sentence for each motion beyond the reach of the model."""
        reach = angles_at_rest(self.model.predictive[0], self.limits, self.plant.true_angle)
        sentences = {name: beyond_reach(_angles(motion), reach) for name, motion in self.motions.items()}
        return tuple(f"{name} {beyond}." for name, beyond in sentences.items() if beyond)

    def steps(self, motion: str) -> int:
        """Number of samples of a motion."""
        return PreviewTable(self.motions[motion], self.plant.dt, 1).steps


def prepare(config: SimulationConfig, known: ControllerModel | None = None) -> Study:
    """Open and build everything that a study needs; all faults of the settings are raised here.

    `known` is the `controller_model` of the same `model`, `inverse` and `actuator_lag_s`; opened where left out.

    Raises:
        ModelError: if a model file is missing or unusable, or `inverse` is a forward model or of another unit.
        ConfigError: if plant and model differ in the command's unit, or a mismatch names an unknown parameter.
        TrajectoryError: if a motion cannot be built.
        ControllerError: if a controller is misconfigured, or the limits exceed the model's without permission.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    models = [model_path(text) for text in (config.model, config.inverse) if text is not None]
    known = known or controller_model(config.model, config.inverse, config.actuator_lag_s)
    facts = known.facts
    limits = modelled_limits(config.limits, limits_of_model(facts))
    flexure = Range(lower=limits.lower, upper=limits.upper)
    plant = make_plant(config.plant, known.predictive[0].dt, flexure, config.seed)
    if plant.command_unit != facts.command_unit:
        raise ConfigError(
            f"plant {config.plant.name} takes {plant.command_unit} and model {config.model} "
            f"{facts.command_unit}, expected one unit"
        )
    motions = {name: motion.build() for name, motion in config.motions.items()}
    rest_deg = plant.true_angle if config.approach else None
    led = {name: _led_to(motion, rest_deg, plant.dt) for name, motion in motions.items()}
    held = ModelledLimitsSettings(lower=limits.lower, upper=limits.upper, rate_per_s=limits.rate)
    study = Study(
        config=config.model_copy(update={"limits": config.limits or held}),
        plant=plant,
        model=known,
        limits=limits,
        motions={name: motion for name, (motion, _) in led.items()},
        approach_s={name: seconds for name, (_, seconds) in led.items()},
        files=(*plant_files(config.plant), *models),
    )
    for name, settings in config.controllers.items():
        _try_out(study, name, settings)
    return study


_FAR = 0.05  # of the reference's range, the rest included: a start that far away needs an approach
_POINTS = 1000


def _angles(motion: Trajectory) -> Vec:
    return motion(np.linspace(0.0, motion.duration_s, _POINTS))


def _led_to(motion: Trajectory, rest_deg: float | None, dt_s: float) -> tuple[Trajectory, float]:
    """Motion after an approach, so that no first jump dominates the error, and the approach's duration [s]."""
    angles = _angles(motion)
    start = float(angles[0])
    if rest_deg is None or abs(start - rest_deg) <= _FAR * float(np.ptp(np.append(angles, rest_deg))):
        return motion, 0.0
    led = approached("", rest_deg, start, motion, dt_s=dt_s)
    return led.trajectory, led.approach_s


def _try_out(study: Study, name: str, settings: AnyControllerSettings) -> None:
    """Build a controller and take one step, so that errors are raised before any run."""
    try:
        controller, y = study.controller(settings), study.plant.reset()
        state = controller.init(y, study.plant.rest_command)
        controller.step(state, y, np.full(controller.horizon, y + 1.0))  # with a reference at rest no plan is made
    except ControllerError as error:
        raise ControllerError(f"controllers.{name}: {error}") from None


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """Signals of one closed-loop run; of two axes angles are (N, 2) and commands (N, n)."""

    log: LoopLog  # of the loop, with measured angles, N samples
    true_deg: Vec  # angles without sensor noise at the ends of the samples (N,) [deg]
    rest_command: float | Vec  # command held before the first sample
    dt: float  # sample time [s]
    unit: str
    first: int = 0  # first sample that counts, after the approach
    __repr__ = brief

    @property
    def error_deg(self) -> Vec:
        """True angle minus reference (N,) [deg]."""
        return self.true_deg - self.log.reference_deg

    @property
    def counted_deg(self) -> Vec:
        """Part of `error_deg` after the approach [deg]."""
        return self.error_deg[self.first :]

    @property
    def axis_rmse_deg(self) -> tuple[float, ...]:
        """Root mean square error of x and y of two axes [deg]; empty of one axis."""
        return tuple(np.sqrt(np.mean(self.counted_deg**2, axis=0)).tolist()) if self.true_deg.ndim > 1 else ()


@final
class _Measuring:
    """Controller that measures those inputs of a plant on which its model depends, at every step."""

    def __init__(self, controller: GuardedController, plant: SimulatedPlant) -> None:
        self._controller, self._plant = controller, plant
        self.dt, self.horizon, self.init = controller.dt, controller.horizon, controller.init
        self.measure = controller.measure

    def step(self, state: GuardedState, y: float, reference: Vec) -> tuple[Command, GuardedState]:
        """Step of the controller, see `GuardedController.step`."""
        seen = {name: value for name, value in self._plant.inputs.items() if name in self._controller.inputs}
        return self._controller.step(self._controller.with_inputs(state, seen), y, reference)


def run_closed_loop(
    controller: Controller[Any],
    plant: ComputedPlant,
    motion: Trajectory,
    on_sample: Callable[[LoopSample], None] | None = None,
    sensor: AnySensorSettings | None = None,
    approach_s: float = 0.0,
) -> ClosedLoopRun:
    """Run a controller along a motion once, from the plant's rest, without waiting for real time.

    Args:
        sensor: of the controller; the plant's angle in every sample where left out. Frames of an imaging system show
            the true angle with noise from the plant's seed; without a sensor the true rest is declared.
        approach_s: duration at the motion's beginning that does not count, a whole number of samples [s].

    Raises:
        ControllerError: if controller and plant differ in sample time, or the controller cannot start from the rest.
    """
    preview = PreviewTable(motion, plant.dt, controller.horizon)
    if isinstance(controller, GuardedController) and isinstance(plant, SimulatedPlant) and controller.inputs:
        controller = _Measuring(controller, plant)
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
