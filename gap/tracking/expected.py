"""The closed-loop error expected before and after a correction, simulated on the corrected simulator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from hystmpc.ctrl.command import CommandLimits, limits_of_model
from hystmpc.ctrl.guarded import build_controller, pair_for
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.loop import Controller
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.sim.closed_loop import ClosedLoopRun, run_closed_loop
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.sim.plants.simulated import conditioned, rest_of
from hystmpc.trajectories.drawn import CountedMotion
from hystmpc.trials.errors import GapError
from hystmpc.trials.types import Vec

from ..diagnosis import MotionTracking, TrackingGap
from ..report.report_data import TrackingCurve

SEEDS = (1, 2)
"""Of the noise; the interval of an error is between its least and its greatest value over them."""

USUAL = LinearisedMpcSettings(adaptation=None, supervisor=None)
"""The controller of which a diagnosis speaks. One that learns finds on the device what its model lacks, and more of it
than in a simulation, where part of it is a walk that nobody can learn: of it no fall can be foretold."""

NEAR = 0.3
"""How far two falls of the error may be from each other, as a share of the expected one, to agree."""

ROUGHNESS = 0.7
"""Of the walk that stands for what is unexplained; chosen on drawn devices of the study's development seed, frozen."""


def expected_tracking(
    nominal: Simulator,
    corrected: Simulator,
    motions: Sequence[CountedMotion],
    *,
    settings: LawSettings | None = None,
    seeds: Sequence[int] = SEEDS,
    floor_deg: float = 0.0,
) -> tuple[TrackingGap, tuple[TrackingCurve, ...]]:
    """The tracking error with a controller on the nominal simulator, and on the corrected one.

    The plant is the corrected simulator with what it leaves unexplained, see `UnexplainedPlant`. Before and after meet
    the same noise, so that equal simulators give equal errors.

        error^2 = mean over the samples that count of (true angle - reference)^2,   overall: mean over the motions

    The fall has to be the same, within `NEAR` of itself, on the corrected simulator alone. Where what is left
    unexplained decides how much a loop gains, no fall is foretold (`why_not`).

    Args:
        motions: at least one.
        settings: of the controller; `USUAL`, the linearised predictive controller without learning, where left out.
        seeds: of the noise, at least one.
        floor_deg: RMSE that stays with any simulator; a fall that it hides counts as none.

    Raises:
        GapError: if the two simulators differ in sample time, unit or limits.
        ControllerError: if a controller cannot be built on a simulator.
        ModelError: if a simulator cannot be used in a controller.
    """
    for name in ("dt_s", "command_unit", "command_limits"):
        if (got := getattr(corrected, name)) != (expected := getattr(nominal, name)):
            raise GapError(f"corrected simulator: {name} {got}, expected that of the nominal one, {expected}")
    limits = limits_of_model(nominal.metadata())
    laws = [_controller(simulator, settings or USUAL, limits) for simulator in (nominal, corrected)]
    plant = UnexplainedPlant(corrected, seeds[0])
    squares, runs = np.empty((len(seeds), len(motions), 2)), list[list[ClosedLoopRun]]()
    for k, seed in enumerate(seeds):
        squares[k], followed = _squares(laws, plant.reseeded(seed), motions)
        runs = runs or followed
    each = tuple(
        MotionTracking(motion.name, *(math.sqrt(float(v)) for v in squares[:, m].mean(axis=0)))
        for m, motion in enumerate(motions)
    )
    before, after = np.sqrt(squares.mean(axis=1)).T
    found = TrackingGap(
        before_deg=math.sqrt(float(squares[..., 0].mean())),
        after_deg=math.sqrt(float(squares[..., 1].mean())),
        before_range_deg=(float(before.min()), float(before.max())),
        after_range_deg=(float(after.min()), float(after.max())),
        motions=each,
    )
    alone = np.sqrt(_squares(laws, UnexplainedPlant(corrected, seeds[0], explained=True), motions)[0].mean(axis=0))
    if why_not := _undetermined(found, TrackingGap(*alone.tolist()), floor_deg):
        return TrackingGap(why_not=why_not), ()
    return found, tuple(_curve(motion, pair, plant.dt) for motion, pair in zip(motions, runs, strict=True))


def _squares(
    laws: Sequence[Controller[Any]], device: ComputedPlant, motions: Sequence[CountedMotion]
) -> tuple[Vec, list[list[ClosedLoopRun]]]:
    """Mean square errors (motions, laws) [deg^2], and the runs."""
    runs = [[run_closed_loop(law, device, motion.trajectory) for law in laws] for motion in motions]
    if any(run.log.interrupted for pair in runs for run in pair):
        raise KeyboardInterrupt
    squares = [
        [float(np.mean(run.error_deg[motion.first(device.dt) :] ** 2)) for run in pair]
        for motion, pair in zip(motions, runs, strict=True)
    ]
    return np.array(squares), runs


def _undetermined(found: TrackingGap, alone: TrackingGap, floor_deg: float) -> str:
    """Why a fall cannot be said, given the one on the corrected simulator alone; empty where it can."""
    if not found.changes(floor_deg) or abs(alone.fall_share - found.fall_share) <= NEAR * abs(found.fall_share):
        return ""
    low, high = sorted((found.fall_share, alone.fall_share))
    return (
        f"what the corrected simulator leaves unexplained decides the fall of the error: {100 * low:.0f} % to "
        f"{100 * high:.0f} %, expected within {100 * NEAR:.0f} % of each other"
    )


def _curve(motion: CountedMotion, pair: Sequence[ClosedLoopRun], dt_s: float) -> TrackingCurve:
    log, first = pair[0].log, motion.first(dt_s)
    before, after = (run.true_deg for run in pair)
    return TrackingCurve(motion.name, log.time_s, log.reference_deg, before, after, first)


def _controller(simulator: Simulator, settings: LawSettings, limits: CommandLimits) -> Controller[Any]:
    model = controller_model(ChainModel(simulator, "conditioned"))
    return build_controller(settings, *pair_for(settings, model), limits)


@final
class UnexplainedPlant(ComputedPlant):
    """A simulator as the device that it says it is, with the noise that its file says it leaves.

        theta_k = model_k + d_k,   d_{k+1} = sqrt(1 - q_k / m^2) d_k + sqrt(q_k) w_k,
        q_k = c^2 (drift^2 dt + motion^2 |u_{k+1} - u_k|),   y_k = theta_k + sensor v_k

    d is the walk of `NoiseModel`, held to its `model_sigma_deg` m; without m it is the walk itself. What a model has
    wrong is smoother than a walk, and a loop rejects it better: c = `ROUGHNESS`. The device rests at its
    command of rest after a flexure over all commands.

    Args:
        seed: of the noise.
        explained: whether nothing is left unexplained, d = 0.
    """

    def __init__(self, simulator: Simulator, seed: int, explained: bool = False) -> None:
        noise = simulator.identification.noise
        self._model, self._noise = CompiledPredictor.of_simulator(simulator), None if explained else noise
        limits = simulator.command_limits
        angle, state = conditioned(simulator, limits)
        self._rest = angle, (state, 0.0, rest_of(simulator, limits))
        self.command_limits = limits
        sensing = Sensing(noise.sensor_sigma_deg if noise else 0.0)
        super().__init__(simulator.dt_s, rest_of(simulator, limits), simulator.command_unit, sensing, seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        del random
        return self._rest

    def _advanced(self, state: Any, u: float, random: np.random.Generator) -> tuple[float, Any]:
        inner, disturbance, before = state
        angle, after = self._model.advance(inner, u)
        if self._noise is not None:
            disturbance = walked(disturbance, abs(u - before), self.dt, self._noise, random.standard_normal())
        return angle + disturbance, (after, disturbance, u)


def walked(disturbance: float, travel: float, dt_s: float, noise: NoiseModel, drawn: float) -> float:
    """The disturbance one sample later."""
    drift, motion = noise.drift_sigma_deg_per_sqrt_s, noise.motion_sigma_deg_per_sqrt_unit
    q = ROUGHNESS**2 * (drift**2 * dt_s + motion**2 * travel)
    kept = 1.0
    if (whole := noise.model_sigma_deg) is not None:
        q = min(q, whole**2)
        kept = math.sqrt(1.0 - q / whole**2) if whole > 0 else 0.0
    return kept * disturbance + math.sqrt(q) * drawn
