"""A closed-loop experiment: preparation, hand-over, a controller along a reference, and back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.ctrl.build import command_limits, modelled_limits
from hystmpc.ctrl.tip.assemble import Assembly, assemble
from hystmpc.ctrl.tip.ruckig_ import Kinematics, move_to_rest
from hystmpc.ctrl.tip_controller import TipController
from hystmpc.trajectories.ruckig_ import PiecewiseCubic
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .bench import BenchResult, Note, run_bench
from .config import RunSettings
from .phases.phase import Phase
from .phases.timely import timely
from .phases.tracking import Tracking
from .plausibility import ModelWatch
from .sample import Sink
from .transports.build import PlantFactory


class LedIn:
    """A reference behind a motion that leads from where the tip is to where it starts.

    Args:
        lead: the motion, None where the tip is there already.
        reference: what follows.
    """

    def __init__(self, lead: PiecewiseCubic | None, reference: Trajectory) -> None:
        self._lead, self._reference = lead, reference
        self._wait = 0.0 if lead is None else lead.duration_s
        self.duration_s = self._wait + reference.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Angles [deg] at times `t` [s]."""
        time = np.asarray(t, dtype=np.float64)
        after = self._reference(time - self._wait)
        if self._lead is None or np.min(time, initial=self._wait) >= self._wait:
            return after
        return np.where(time < self._wait, self._lead(time), after)


def tracking_phase(settings: RunSettings) -> Tracking:
    """The controller of an experiment, compiled and warm, as a phase.

    Raises:
        ConfigError: if model and bench differ in rate or unit, or the controller's limits go beyond the bench's.
        ModelError: if a model file is missing, corrupt or unusable.
        ControllerError: if the settings of the controller contradict each other or the model, or limits go beyond the
            model's unasked.
        TrajectoryError: if the reference cannot be made.
    """
    limits, tip_settings = settings.limits, settings.controller
    ladder = tip_settings.controller.ladder
    if ladder.safe_command is None:  # a stop of the controller's own goes where the loop's would
        law = tip_settings.controller
        law = law.model_copy(update={"ladder": ladder.model_copy(update={"safe_command": settings.safe_command})})
        tip_settings = tip_settings.model_copy(update={"controller": law})
    tip_settings = tip_settings.model_copy(
        update={"limits": tip_settings.limits or limits, "start_command": settings.safe_command}
    )
    assembly = assemble(tip_settings, Path())
    _fits(settings, assembly)
    controller, law_of_it = timely(assembly.controller)
    tip = TipController(replace(assembly, controller=controller), tip_settings)
    reference = settings.reference.build()
    motion = tip_settings.motion

    def lead_in(angle_deg: float) -> Trajectory:
        segments = move_to_rest(Kinematics(angle_deg), float(reference(0.0)), motion)
        return LedIn(PiecewiseCubic(segments) if segments.size else None, reference)

    drill = settings.drill
    fails = None if drill is None else (drill.solver_fails_from_s, drill.solver_fails_from_s + drill.solver_fails_for_s)
    estimator = getattr(tip_settings.controller, "estimator", None)
    limit = math.inf if estimator is None else estimator.disturbance_limit_deg
    watch = ModelWatch(settings.plausibility, limit, settings.dt_s)
    return Tracking(tip, law_of_it, lead_in, watch, fails)


def _fits(settings: RunSettings, assembly: Assembly) -> None:
    dt_s, unit = assembly.controller.dt, assembly.unit
    if abs(dt_s * settings.rate_hz - 1) > 1e-6:
        raise ConfigError(
            f"controller: got a model at {1 / dt_s:g} Hz, expected rate_hz {settings.rate_hz:g}; identify one at that "
            "rate (`fit --rate`), or run at the model's"
        )
    if unit != settings.command_unit:
        raise ConfigError(f"controller: got a model with commands in {unit}, expected {settings.command_unit}")
    modelled_limits(settings.limits, assembly.model_limits)
    bench = command_limits(settings.limits)
    if not bench.contains(assembly.limits):
        raise ConfigError(f"controller: got limits {assembly.limits}, expected them within the bench's {bench}")


def run_experiment(
    settings: RunSettings,
    sink: Callable[[], Sink],
    plants: PlantFactory,
    *,
    folder: Path | None = None,
    note: Note = lambda text: None,
) -> BenchResult:
    """Do the experiment; everything that can be wrong is found before anything moves.

    Args:
        settings: of the experiment.
        sink: opens where samples go.
        plants: makes the device of `kind: simulated`.
        folder: run folder.
        note: told what goes on, outside the loop.

    Raises:
        HystmpcError: of any kind, see `tracking_phase` and `run_bench`.
    """
    phase: list[Phase] = [tracking_phase(settings)]
    return run_bench(settings, lambda: phase, sink, plants, folder=folder, note=note)
