"""Closed-loop tracking error expected with the simulator as given and with the corrected one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import CommandLimits, limits_of_model
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.loop import Controller
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.sim.plants.simulated import conditioned, rest_of
from hystmpc.sim.study import ClosedLoopRun, run_closed_loop
from hystmpc.trajectories.drawn import CountedMotion, drawn_motions
from hystmpc.trials.errors import GapError, HystmpcError
from hystmpc.trials.types import Progress, Vec, no_progress

from .diagnosis import FLIPS, Diagnosis, MotionTracking, TrackingGap
from .report.report_data import ReportData, TrackingCurve, TrialRuns

SEEDS = (1, 2)
"""Seeds of the noise; they give the least and the greatest value of an error."""

DEFAULT_CONTROLLER = LinearisedMpcSettings(adaptation=None, supervisor=None)
"""Controller of the predicted tracking error, without learning: on a device it would learn more of the model error than
of the random walk that represents this error in a simulation, so that no prediction is possible."""

AGREEMENT = 0.3
"""Greatest difference between two agreeing falls of the error, as a share of the expected one."""

ROUGHNESS = 0.7
"""Scale of the walk of the unexplained disturbance; chosen on devices of the study's development seed, frozen."""


def expected_tracking(
    nominal: Simulator,
    corrected: Simulator,
    motions: Sequence[CountedMotion],
    *,
    settings: LawSettings | None = None,
    seeds: Sequence[int] = SEEDS,
    floor_deg: float = 0.0,
) -> tuple[TrackingGap, tuple[TrackingCurve, ...]]:
    """Expected tracking error with a controller on the nominal simulator, and on the corrected one.

    The plant is the corrected simulator with its unexplained disturbance, see `UnexplainedPlant`. Before and after
    share the same noise, so that equal simulators give equal errors.

        error^2 = mean over the samples that count of (true angle - reference)^2,   overall: mean over the motions

    The fall must be the same, within `AGREEMENT` of itself, on the corrected simulator alone. If the unexplained part
    decides the gain of a loop, no fall is predicted (`why_not`).

    Args:
        settings: of the controller; if left out, `DEFAULT_CONTROLLER`, linearised and predictive without learning.
        floor_deg: irreducible RMSE of any simulator; a smaller fall counts as none.

    Raises:
        GapError: if the two simulators differ in sample time, unit or limits.
        ControllerError: if a controller cannot be built on a simulator.
        ModelError: if a simulator cannot be used in a controller.
    """
    for name in ("dt_s", "command_unit", "command_limits"):
        if (got := getattr(corrected, name)) != (expected := getattr(nominal, name)):
            raise GapError(f"corrected simulator: {name} {got}, expected that of the nominal one, {expected}")
    limits = limits_of_model(nominal.metadata())
    laws = [_controller(simulator, settings or DEFAULT_CONTROLLER, limits) for simulator in (nominal, corrected)]
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
    gap = TrackingGap(
        before_deg=math.sqrt(float(squares[..., 0].mean())),
        after_deg=math.sqrt(float(squares[..., 1].mean())),
        before_range_deg=(float(before.min()), float(before.max())),
        after_range_deg=(float(after.min()), float(after.max())),
        motions=each,
    )
    alone = np.sqrt(_squares(laws, UnexplainedPlant(corrected, seeds[0], explained=True), motions)[0].mean(axis=0))
    if why_not := _undetermined(gap, TrackingGap(*alone.tolist()), floor_deg):
        return TrackingGap(why_not=why_not), ()
    curves = []
    for motion, pair in zip(motions, runs, strict=True):
        (before_deg, after_deg), log = (run.true_deg for run in pair), pair[0].log
        first = motion.first(plant.dt)
        curves.append(TrackingCurve(motion.name, log.time_s, log.reference_deg, before_deg, after_deg, first))
    return gap, tuple(curves)


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


def _undetermined(gap: TrackingGap, alone: TrackingGap, floor_deg: float) -> str:
    """Reason for an undetermined fall of the error, from the fall without disturbance; otherwise empty."""
    if not gap.changes(floor_deg) or abs(alone.fall_share - gap.fall_share) <= AGREEMENT * abs(gap.fall_share):
        return ""
    low, high = sorted((gap.fall_share, alone.fall_share))
    return (
        f"what the corrected simulator leaves unexplained decides the fall of the error: {100 * low:.0f} % to "
        f"{100 * high:.0f} %, expected within {100 * AGREEMENT:.0f} % of each other"
    )


def _controller(simulator: Simulator, settings: LawSettings, limits: CommandLimits) -> Controller[Any]:
    model = controller_model(ChainModel(simulator, "conditioned"))
    return build_controller(settings, *pair_for(settings, model), limits)


@final
class UnexplainedPlant(ComputedPlant):
    """Simulated plant: a simulator with the sensor noise and the unexplained disturbance of its file.

        theta_k = model_k + d_k,   d_{k+1} = sqrt(1 - q_k / m^2) d_k + sqrt(q_k) w_k,
        q_k = c^2 (drift^2 dt + motion^2 |u_{k+1} - u_k|),   y_k = theta_k + sensor v_k

    d is the walk of `NoiseModel`, limited to its `model_sigma_deg` m; without m it is the walk itself. Model errors are
    smoother than a walk, and a loop rejects them better: c = `ROUGHNESS`. The plant rests at its rest command after a
    flexure over all commands.
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
            disturbance = next_disturbance(disturbance, abs(u - before), self.dt, self._noise, random.standard_normal())
        return angle + disturbance, (after, disturbance, u)


def next_disturbance(disturbance: float, travel: float, dt_s: float, noise: NoiseModel, drawn: float) -> float:
    """Unexplained disturbance after one more sample [deg]."""
    drift, motion = noise.drift_sigma_deg_per_sqrt_s, noise.motion_sigma_deg_per_sqrt_unit
    q = ROUGHNESS**2 * (drift**2 * dt_s + motion**2 * travel)
    kept = 1.0
    if (whole := noise.model_sigma_deg) is not None:
        q = min(q, whole**2)
        kept = math.sqrt(1.0 - q / whole**2) if whole > 0 else 0.0
    return kept * disturbance + math.sqrt(q) * drawn


SCANS_HZ = {"scan": 0.2}
LEAST_CLOSED = 0.8
"""Least closed share of the structural gap for a prediction: with less, the simulation does not represent the loop."""

_MOVES = 3
_COVERED = (0.02, 0.98)  # quantiles of the simulated angles: rare extremes are excluded
_FASTEST, _SPEED_SHARE = 0.99, 0.5  # quantile of the simulated speed, and the share of it in a reference
_FAST_DT_S = 0.019  # below it a second seed would take too long


def with_tracking(data: ReportData, progress: Progress | None = None) -> ReportData:
    """Add the expected fall of the closed-loop tracking error to the report data and its diagnosis.

    References are drawn from the seed of the diagnosis, within the angles of the trials (as simulated with the effects)
    and half of their greatest speed.
    """
    report = progress or no_progress
    report(98, 100, "closed loop before and after")
    curves: tuple[TrackingCurve, ...] = ()
    why_not = _why_not(data)
    gap = TrackingGap(why_not=why_not)
    if not why_not and data.nominal is not None and data.fixed is not None:
        seeds = SEEDS if data.nominal.dt_s > _FAST_DT_S else SEEDS[:1]
        try:
            motions = covered_motions(data.trials, data.fixed, data.seed)
            gap, curves = expected_tracking(
                data.nominal, data.fixed, motions, seeds=seeds, floor_deg=data.diagnosis.gap.floor_rmse_deg
            )
        except HystmpcError as error:
            gap = TrackingGap(why_not=f"the closed loop could not be simulated ({error})")
    report(100, 100, data.diagnosis.verdict)
    return replace(data, diagnosis=replace(data.diagnosis, tracking=gap), curves=curves)


def covered_motions(trials: Sequence[TrialRuns], fixed: Simulator, seed: int) -> tuple[CountedMotion, ...]:
    """Reference motions within the angles and half of the speed covered by the trials."""
    angles = [trial.with_effects for trial in trials]
    low, high = np.quantile(np.concatenate(angles), _COVERED)
    speeds = [np.abs(np.diff(trial.with_effects)) / trial.trial.dt for trial in trials]
    speed = _SPEED_SHARE * float(np.quantile(np.concatenate(speeds), _FASTEST))
    rest = UnexplainedPlant(fixed, seed).true_angle
    random = np.random.default_rng([seed, 3])
    return drawn_motions(random, rest, (float(low), float(high)), speed, SCANS_HZ, moves=_MOVES)


def _why_not(data: ReportData) -> str:
    """Reason why no fall of the error can be predicted, in one sentence; otherwise empty."""
    diagnosis: Diagnosis = data.diagnosis
    if data.unit != "deg":
        return f"the controllers follow angles in deg, and the output of this device is in {data.unit}"
    if data.nominal is None:
        return "the simulator is a network, of which a diagnosis makes no corrected simulator"
    if diagnosis.verdict == "too_little":
        return "these logs do not allow a diagnosis"
    if diagnosis.verdict == "unknown" or data.fixed is None:
        return "the gap has a cause that is not known, so that no simulator stands for the device"
    if diagnosis.relies_on_its_split:
        return FLIPS
    closed = diagnosis.gap.closed_share
    if diagnosis.verdict not in ("none", "retuned") and not closed >= LEAST_CLOSED:
        return (
            f"the corrected simulator closes {100 * closed:.0f} % of the structural gap, expected "
            f"{100 * LEAST_CLOSED:.0f} % or more for it to stand for the device in a closed loop"
        )
    return ""
