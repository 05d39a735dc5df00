"""Experiment on a device of two axes: the phase that tracks a motion in the plane of both angles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisLimitsSettings, TwoAxisTipController, within_limits
from hystmpc.models.two_axes.model import AXES, TwoAxisModel, load_two_axes
from hystmpc.trajectories.plane import PlaneMotion, after_approach
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import ConfigError, ControllerError

from ..axes import PerAxis, each
from ..live.desk import Desk
from ..plane_config import PlaneRunSettings
from ..recording.sample import Sink
from ..run import BenchResult, Note, run_bench
from ..safety.plausibility import AxesFrame
from ..safety.stop import cause_of
from ..transports.transport import PlantFactory
from .experiment import Tracking, model_watch, not_measured

_POINTS, _BEYOND_DEG = 400, 0.5  # of a reference that are looked at; distance to the reach that is mentioned


def run_plane_experiment(
    settings: PlaneRunSettings,
    sink: Callable[[], Sink],
    plants: PlantFactory,
    *,
    folder: Path | None = None,
    note: Note = lambda text: None,
    desk: Desk | None = None,
) -> BenchResult:
    """Run the experiment after a check of settings and model; arguments as of `run_bench`.

    Raises:
        HystmpcError: of `plane_tracking` and `run_bench`.
    """
    tracking, frame = plane_tracking(settings, note)
    return run_bench(settings, lambda: [tracking], sink, plants, folder=folder, note=note, desk=desk, frame=frame)


def plane_tracking(
    settings: PlaneRunSettings, note: Note = lambda text: None, threaded: bool = True
) -> tuple[Tracking, AxesFrame]:
    """Phase that tracks the reference with a controller of two axes, and the coordinates of the model's axes.

    Args:
        threaded: as of `tracking_phase`.
        note: called where the reference is beyond the model's reach.

    Raises:
        ConfigError: if model and bench differ in rate, unit or count of commands, or the controller's limits exceed the
            bench's.
        ModelError: if the model file is missing or has not two axes.
        ControllerError: if settings contradict each other or the model, or limits exceed the model's without
            permission.
        TrajectoryError: if the reference cannot be built.
    """
    wanted = settings.controller
    bench = TwoAxisLimitsSettings.parse(settings.limits.model_dump(), "limits")
    model = load_two_axes(wanted.model)
    _fits(settings, model)
    allowed = within_limits(model, bench)
    limits = wanted.limits or bench
    if not all(map(_contains, settings.limits.lower, settings.limits.upper, limits.lower, limits.upper)) or any(
        one > most for one, most in zip(limits.rate_per_s, settings.limits.rate_per_s, strict=True)
    ):
        raise ConfigError("controller.limits: got limits beyond those of the bench, expected them within `limits`")
    update = {"limits": limits, "start_command": wanted.start_command or settings.safe_command}
    tip = TwoAxisTipController(model, wanted.model_copy(update=update))
    reference = settings.reference.build()
    _take_first_step(tip, reference)
    _mention_reach(tip, reference, note)
    if line := not_measured(model.inputs, settings.inputs):
        note(line)

    def lead_in(angles_deg: PerAxis) -> Trajectory:
        x, y = each(angles_deg)
        # The loop passes on what it gets: motions and controllers of both axes in place of those of one.
        return cast(Trajectory, after_approach(reference, (x, y), tip.dt, wanted.motion))

    watch = model_watch(settings.plausibility, wanted.controller, settings.dt_s)
    return Tracking(cast(TipController, tip), lead_in, watch, None, threaded=threaded), AxesFrame.of(allowed)


def _fits(settings: PlaneRunSettings, model: TwoAxisModel) -> None:
    if abs(model.dt_s * settings.rate_hz - 1) > 1e-6:
        raise ConfigError(
            f"controller: got a model at {1 / model.dt_s:g} Hz, expected rate_hz {settings.rate_hz:g}; identify one at "
            "that rate (`fit --rate-hz`), or run at the model's"
        )
    if model.axes[0].command_unit != settings.command_unit:
        unit = model.axes[0].command_unit
        raise ConfigError(f"controller: got a model with commands in {unit}, expected {settings.command_unit}")
    if (count := len(model.command_limits)) != AXES:
        raise ConfigError(f"controller: got a model of {count} commands, expected two: Clarke's coordinates of tendons")


def _contains(low: float, high: float, lower: float, upper: float) -> bool:
    return low <= lower and upper <= high


def _take_first_step(tip: TwoAxisTipController, reference: PlaneMotion) -> None:
    """Take one step from rest without the device, so that every error is raised before anything moves.

    Raises:
        ControllerError: if the controller cannot start or take over, or its first command is that of a stop.
    """
    tip.reset(np.zeros(AXES))
    tip.set_reference(reference)
    command = tip.step(np.zeros(AXES))
    if tip.state().stopped:
        raise ControllerError(f"controller: the first step without the device stopped: {command.status}")
    try:
        tip.replay(np.tile(command.u, (2, 1)), np.zeros((2, AXES)))
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not happen while the device moves
        raise ControllerError(
            f"controller: {cause_of(error)} as it takes over from a recording, expected one that can; of a model with "
            "shared friction a PID cannot: leave cross_friction out of the PID's model"
        ) from None
    tip.reset()


def _mention_reach(tip: TwoAxisTipController, reference: PlaneMotion, note: Note) -> None:
    points = reference(np.linspace(0.0, reference.duration_s, _POINTS))
    gap = max(float(np.hypot(*(tip.reachable(point).nearest_deg - point))) for point in points)
    if gap > _BEYOND_DEG:
        note(f"warning: the reference goes {gap:.3g} deg beyond what the model reaches within the limits")
