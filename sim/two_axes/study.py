"""Closed-loop study of two axes: files opened, controllers built, and runs of one controller along one motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.ctrl.loop import LoopSample
from hystmpc.ctrl.two_axes.guarded import TwoAxisController
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisLimitsSettings, within_limits
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel
from hystmpc.models.two_axes.model import AXES, TwoAxisModel, load_two_axes
from hystmpc.trajectories import PreviewTable
from hystmpc.trajectories.plane import PlaneMotion, after_approach
from hystmpc.trials.errors import ConfigError, ControllerError, TrajectoryError
from hystmpc.trials.types import Vec

from ..study import ClosedLoopRun, Study, run_closed_loop
from .config import TwoAxisSimulationConfig
from .plant import TwoAxisPlant

_FAR = 0.05  # of the reference's range: a start that far from the rest needs an approach
_POINTS = 400  # of a motion that are looked at
_BEYOND_DEG = 0.5


@dataclass(frozen=True, eq=False)
class TwoAxisStudy:
    """Closed-loop study of two axes that is ready to run, see `Study`.

    Attributes:
        model: of the controllers, within the limits of the study.
        motions: references, each after an approach where it starts far from the plant's rest.
        approach_s: duration of each approach, 0 for none [s].
    """

    config: TwoAxisSimulationConfig
    plant: TwoAxisPlant
    model: TwoAxisModel
    motions: Mapping[str, PlaneMotion]
    approach_s: Mapping[str, float]
    files: tuple[Path, ...]

    def run(
        self, settings: AnyControllerSettings, motion: str, on_sample: Callable[[LoopSample], None] | None = None
    ) -> ClosedLoopRun:
        """Run one controller along one motion.

        Raises:
            ControllerError: if the settings contradict each other.
            KeyboardInterrupt: if the user ended it, since an unfinished run is no result.
        """
        controller, plant, reference = TwoAxisController(self.model, settings), self.plant, self.motions[motion]
        approach_s = self.approach_s[motion]
        # The loop passes on what it gets: arrays of both axes in place of numbers.
        run = run_closed_loop(cast(Any, controller), cast(Any, plant), reference, on_sample, approach_s=approach_s)
        if run.log.interrupted:
            raise KeyboardInterrupt
        return run

    def warnings(self) -> tuple[str, ...]:
        """One sentence for each motion beyond the reach of the model."""
        controller = TwoAxisController(self.model, next(iter(self.config.controllers.values())))
        gaps = {name: _beyond(controller, motion) for name, motion in self.motions.items()}
        return tuple(
            f"{name} goes {gap:.3g} deg beyond what the model reaches within the limits of the commands."
            for name, gap in gaps.items()
            if gap > _BEYOND_DEG
        )

    def needed_travel(self, motion: str) -> float:
        """Command travel of the model's inverse along a motion, without feedback and noise [command unit].

        Both axes are inverted in their own coordinates, without the friction that they share.
        """
        pairs = [controller_model(ChainModel(axis, "conditioned")).feedforward for axis in self.model.axes]
        limits, dt_s, u = self.config.command_limits(), self.plant.dt, self.plant.rest_command
        reference, travel, w = PreviewTable(cast(Any, self.motions[motion]), dt_s, 1), 0.0, self.model.travels(u)
        y = self.model.in_axes(reference.at(0)[0])
        states = [predictor.initial(float(y[i]), float(w[i])) for i, (predictor, _) in enumerate(pairs)]
        for k in range(reference.steps):
            y = self.model.in_axes(reference.at(k)[0])
            wanted = [inverse.command(states[i], float(y[i]), float(w[i])) for i, (_, inverse) in enumerate(pairs)]
            sent = zip(limits, self.model.commands(wanted).tolist(), u.tolist(), strict=True)
            now = np.array([one.clip(value, last, dt_s) for one, value, last in sent])
            travel, u, w = travel + float(np.abs(now - u).sum()), now, self.model.travels(now)
            states = [predictor.advance(states[i], float(w[i]))[1] for i, (predictor, _) in enumerate(pairs)]
        return travel

    def steps(self, motion: str) -> int:
        """Number of samples of a motion."""
        return PreviewTable(self.motions[motion], self.plant.dt, 1).steps


AnyStudy = Study | TwoAxisStudy


def prepare_two_axes(config: TwoAxisSimulationConfig) -> TwoAxisStudy:
    """Open and build everything that a study needs; all faults of the settings are raised here.

    Raises:
        ModelError: if a model file is missing or unusable.
        ConfigError: if command units differ, a model has more than two commands, or a mismatch names no parameter.
        TrajectoryError: if a motion cannot be built, or its tip is out of reach.
        ControllerError: if a controller is misconfigured, or the limits exceed the model's without permission.
    """
    model = within_limits(load_two_axes(config.model), config.limits)
    device = load_two_axes(config.plant.simulator).at_sample_time(model.dt_s)
    for file, one in ((config.plant.simulator, device), (config.model, model)):
        if (n := len(one.command_limits)) != AXES:
            raise ConfigError(f"{file}: a model of {n} commands, expected two: save `in_travels()` of that model")
    unit, known = device.axes[0].command_unit, model.axes[0].command_unit
    if unit != known:
        raise ConfigError(f"plant {config.plant.name} takes {unit} and model {config.model} {known}, expected one unit")
    plant, motions, approach_s = TwoAxisPlant(device, config.plant, config.seed), dict[str, PlaneMotion](), {}
    for name, motion in config.motions.items():
        try:
            motions[name], approach_s[name] = _led(motion.build(), plant, config.approach)
        except TrajectoryError as error:
            raise TrajectoryError(f"motions.{name}: {error}") from None
    held = TwoAxisLimitsSettings(
        lower=tuple(limits.lower for limits in model.command_limits),
        upper=tuple(limits.upper for limits in model.command_limits),
        rate_per_s=tuple(model.command_rates_per_s),
    )
    for name, settings in config.controllers.items():
        _try_out(model, plant, name, settings)
    config = config.model_copy(update={"limits": config.limits or held})
    files = (Path(config.plant.simulator), Path(config.model))
    return TwoAxisStudy(config, plant, model, motions, approach_s, files)


def _led(motion: PlaneMotion, plant: TwoAxisPlant, wanted: bool) -> tuple[PlaneMotion, float]:
    """Motion after an approach where it starts far from the rest, and the approach's duration [s]."""
    rest, angles = plant.true_angle, _angles(motion)
    far = _FAR * float(np.hypot(*np.ptp(np.vstack([angles, rest]), axis=0)))
    if not wanted or float(np.hypot(*(angles[0] - rest))) <= far:
        return motion, 0.0
    led = after_approach(motion, (float(rest[0]), float(rest[1])), plant.dt)
    return led, led.duration_s - motion.duration_s


def _angles(motion: PlaneMotion) -> Vec:
    return motion(np.linspace(0.0, motion.duration_s, _POINTS))


def _beyond(controller: TwoAxisController, motion: PlaneMotion) -> float:
    """Greatest distance of a motion from the angles that the commands can hold [deg]."""
    nothing = np.zeros(2)
    return max(float(np.hypot(*(controller.nearest(one, nothing)[0] - one))) for one in _angles(motion))


def _try_out(model: TwoAxisModel, plant: TwoAxisPlant, name: str, settings: AnyControllerSettings) -> None:
    """Build a controller and take one step, so that errors are raised before any run."""
    try:
        controller, y = TwoAxisController(model, settings), plant.reset()
        state = controller.init(y, plant.rest_command)
        controller.step(state, y, np.tile(y + 1.0, (controller.horizon, 1)))
    except ControllerError as error:
        raise ControllerError(f"controllers.{name}: {error}") from None
