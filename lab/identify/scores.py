"""Closed-loop runs on a drawn device and their figures, and an identified model as a plant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import CommandLimits, Source
from hystmpc.ctrl.guarded import GuardedController, LawSettings
from hystmpc.ctrl.loop import Controller, ImagingSettings, NoSensorSettings
from hystmpc.models.contract.metadata import Range
from hystmpc.models.prediction.build import ControllerModel
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.sim.results import holds, violations
from hystmpc.sim.study import ClosedLoopRun, run_closed_loop
from hystmpc.trajectories.drawn import CountedMotion
from hystmpc.trials.types import Vec

from ..devices.drawn import DrawnDevice

AS_IDENTIFIED_NOISE_DEG = 0.15
SETTLED_S = 1.0
"""Time after which a hold has settled, beside the delay and three lags [s]."""

_AT_REST = 1e-6  # of the command's range


def scores(
    runs: Sequence[ClosedLoopRun],
    motions: Sequence[CountedMotion],
    limits: CommandLimits,
    delay_s: float,
    lag_s: float,
) -> dict[str, float]:
    """Figures of one controller over all motions; only what comes after the approach counts, but for limits and stops.

    `rmse_deg` is the root of the mean over motions of the mean square true error, `rmse_deg.MOTION` that of one.
    `hold_samples` are those of holds that have settled, until the command may prepare the next move, which is the delay
    earlier than the move itself; in `rest_samples` of them the command did not move. `violations` are samples beyond a
    limit, `stops` samples in which the controller gave up.
    """
    squares, held, resting, beyond, stops = dict[str, float](), 0, 0, 0, 0
    for run, motion in zip(runs, motions, strict=True):
        first = motion.first(run.dt)
        squares[motion.name] = float(np.mean(run.error_deg[first:] ** 2))
        still = np.abs(np.diff(run.log.command, prepend=run.rest_command)) <= _AT_REST * (limits.upper - limits.lower)
        settle, early = round((SETTLED_S + delay_s + 3 * lag_s) / run.dt), math.ceil(delay_s / run.dt) + 1
        for start, stop in holds(run.log.reference_deg, run.dt):
            part = still[max(start + settle, first) : max(stop - early, 0)]
            held, resting = held + part.size, resting + int(np.sum(part))
        beyond += violations(run.log.command, run.rest_command, limits, run.dt)
        stops += sum(source == Source.STOP for source in run.log.source)
    return {
        "rmse_deg": math.sqrt(float(np.mean(list(squares.values())))),
        **{f"rmse_deg.{name}": math.sqrt(square) for name, square in squares.items()},
        "hold_samples": float(held),
        "rest_samples": float(resting),
        "violations": float(beyond),
        "stops": float(stops),
    }


def tracked(
    name: str,
    controller: Controller[Any],
    plant: ComputedPlant,
    motions: Sequence[CountedMotion],
    device: DrawnDevice,
    delay_s: float | None = None,
    sensor: ImagingSettings | NoSensorSettings | None = None,
) -> tuple[dict[str, float], list[ClosedLoopRun]]:
    """Figures of a controller over all motions, `name` before each, and the runs.

    Args:
        device: whose limits and lag count.
        delay_s: of the plant [s]; the device's where left out.

    Raises:
        KeyboardInterrupt: if the user ended it.
    """
    runs = []
    for motion in motions:
        runs.append(run_closed_loop(controller, plant, motion.trajectory, sensor=sensor))
        if runs[-1].log.interrupted:
            raise KeyboardInterrupt
    figures = scores(runs, motions, device.limits, device.delay_s if delay_s is None else delay_s, device.lag_s)
    return {f"{name}.{figure}": value for figure, value in figures.items()}, runs


def controller_on(settings: LawSettings, known: ControllerModel, limits: CommandLimits) -> GuardedController[Any]:
    """A controller with a model: predictor and inverse as its law needs them."""
    return build_controller(settings, *pair_for(settings, known), limits)


@final
class IdentifiedPlant(ComputedPlant):
    """A model as the device that it says it is.

    Args:
        rest_deg: angle that it rests at before a run, at its lowest command [deg].
        noise_deg: standard deviation of the sensor's white noise [deg].
        seed: of the noise.
    """

    def __init__(self, known: ControllerModel, rest_deg: float, noise_deg: float, seed: int) -> None:
        self._predictor, limits = known.predictive[0], known.facts.command_limits
        self._rest = self._predictor.advance(self._predictor.initial(rest_deg, limits.lower), limits.lower)
        self.command_limits = Range(lower=limits.lower, upper=limits.upper)
        super().__init__(self._predictor.dt, limits.lower, known.facts.command_unit, Sensing(noise_deg), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self._rest

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self._predictor.advance(state, u)
