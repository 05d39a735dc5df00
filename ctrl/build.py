"""From settings to a controller; everything that can be wrong is found here, before the first sample."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.errors import ControllerError

from .adaptive.estimator import LearningEstimator, LearningOptions
from .adaptive.predictor import LearnedInverse, LearnedOptions, LearnedPredictor
from .candidates import Candidates
from .config import (
    AdaptationSettings,
    AnyControllerSettings,
    EstimatorSettings,
    HoldSettings,
    InverseControllerSettings,
    InversePidControllerSettings,
    LimitsSettings,
    LinearisedMpcSettings,
    ModelledLimitsSettings,
    PidControllerSettings,
    PidSettings,
    SamplingMpcSettings,
    SplineNoiseSettings,
    WeightsSettings,
)
from .estimator import EstimatorOptions, OutputEstimator
from .guarded import GuardedController
from .hold import HoldRule
from .inverse_feedforward import InverseFeedforward
from .inverse_pid import InversePid
from .ladder import Ladder, LadderOptions
from .law import Law
from .limits import CommandLimits
from .linearised.daqp_ import DaqpOptions
from .linearised.osqp_ import OsqpOptions
from .linearised.planner import LinearisedPlanner
from .mpc import PredictiveLaw
from .observer import Observer, WithoutModel
from .pid import Pid, PidFeedback, PidGains
from .planning import Planner, Weights
from .sampling.cem import CrossEntropyOptions, CrossEntropyPlanner
from .sampling.noise import coloured_noise, spline_noise
from .sampling.options import SampleOptions
from .sampling.planner import SamplingOptions, SamplingPlanner

_WithModel = InverseControllerSettings | InversePidControllerSettings | LinearisedMpcSettings | SamplingMpcSettings


def build_controller(
    settings: AnyControllerSettings,
    predictor: Predictor,
    inverse: Inverse,
    limits: CommandLimits,
) -> GuardedController[Any]:
    """The controller that `settings` describe.

    Args:
        settings: one of the classes of `CONTROLLERS`.
        predictor: the model; PID takes only the sample time from it.
        inverse: its inverse, for feedforward, candidate plans and fallback.
        limits: hard limits of the device; `settings.limits` may narrow them.

    Raises:
        ControllerError: if the settings contradict each other or go beyond the device's limits.
    """
    limits = _narrowed(limits, settings.limits)
    predictor, inverse = learned_pair(settings, predictor, inverse)
    ladder_options = LadderOptions(settings.ladder.stop_after_failures, settings.ladder.safe_command)
    if isinstance(settings, PidControllerSettings):
        observer: Observer = WithoutModel()
        law: Law[Any] = PidFeedback(_pid(settings.gains, limits, predictor.dt), limits)
        ladder = Ladder(limits, ladder_options, inverse=None)
    else:
        observer = _estimator(settings, predictor)
        law = _model_law(settings, predictor, inverse, limits)
        ladder = Ladder(limits, ladder_options, inverse)
    return GuardedController(law, observer, ladder, limits, predictor.dt, settings.ladder.max_missing_samples)


def _model_law(
    settings: _WithModel,
    predictor: Predictor,
    inverse: Inverse,
    limits: CommandLimits,
) -> Law[Any]:
    if isinstance(settings, InverseControllerSettings):
        return InverseFeedforward(inverse, settings.reference_dead_zone_deg)
    if isinstance(settings, InversePidControllerSettings):
        feedforward = InverseFeedforward(inverse, settings.reference_dead_zone_deg)
        return InversePid(feedforward, _pid(settings.gains, limits, predictor.dt), predictor, limits)
    weights = _weights(settings.weights)
    return PredictiveLaw(
        predictor,
        Candidates(predictor, inverse, limits, settings.horizon),
        _planner(settings, predictor, weights, limits),
        weights,
        settings.horizon,
        _hold_rule(settings.hold, predictor.dt),
    )


def learned_pair(settings: AnyControllerSettings, predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
    """Model and inverse with a learned part on top where the settings ask for one and there is none yet.

    Who predicts from a controller's own state, as `TipController.predict` does, needs the predictor that it has.

    Raises:
        ControllerError: if the settings of the learned part are out of bounds.
    """
    asked = settings.adaptation if isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings) else None
    if asked is None or isinstance(predictor, LearnedPredictor):
        return predictor, inverse
    learned = LearnedPredictor(predictor, LearnedOptions(asked.plays, asked.widest_share, asked.lag_s))
    return learned, LearnedInverse(learned, inverse)


def _estimator(settings: _WithModel, predictor: Predictor) -> Observer:
    options = _estimator_options(settings.estimator)
    if isinstance(predictor, LearnedPredictor) and isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings):
        asked = settings.adaptation or AdaptationSettings()
        learning = LearningOptions(asked.share_sigma, asked.slope_sigma, asked.rate_sigma_s, asked.walk_share)
        return LearningEstimator(predictor, options, learning)
    return OutputEstimator(predictor, options)


def _hold_rule(settings: HoldSettings, dt: float) -> HoldRule:
    patience, lead, after, settle = (
        round(seconds / dt)
        for seconds in (settings.patience_s, settings.lead_s, settings.settle_after_s, settings.settle_s)
    )
    return HoldRule(settings.tolerance_deg, patience, max(lead, 1), after, settle)


def _planner(
    settings: LinearisedMpcSettings | SamplingMpcSettings,
    predictor: Predictor,
    weights: Weights,
    limits: CommandLimits,
) -> Planner[Any]:
    horizon = settings.horizon
    if isinstance(settings, LinearisedMpcSettings):
        options = DaqpOptions() if settings.solver == "daqp" else OsqpOptions(eps=settings.solver_eps)
        blocks = settings.move_blocking
        return LinearisedPlanner(predictor, weights, limits, horizon, settings.iterations, options, blocks)
    noise = _noise(settings)
    common = {f.name: getattr(settings, f.name) for f in fields(SampleOptions)}
    if settings.method == "cem":
        cem = CrossEntropyOptions(**common, elites=settings.elites)
        return CrossEntropyPlanner(predictor, weights, limits, noise, cem)
    mppi = SamplingOptions(**common, temperature=settings.temperature)
    return SamplingPlanner(predictor, weights, limits, noise, mppi)


def _noise(settings: SamplingMpcSettings) -> NDArray[np.float64]:
    noise = settings.noise
    if isinstance(noise, SplineNoiseSettings):
        return spline_noise(settings.horizon, noise.knots)
    return coloured_noise(settings.horizon, noise.exponent)


def _narrowed(device: CommandLimits, wanted: LimitsSettings | None) -> CommandLimits:
    if wanted is None:
        return device
    limits = command_limits(wanted)
    if not device.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within those of the device, {device}")
    return limits


def command_limits(settings: LimitsSettings) -> CommandLimits:
    """The limits that the settings name."""
    return CommandLimits(settings.lower, settings.upper, settings.rate_per_s)


def limits_of_model(facts: ModelMetadata) -> CommandLimits:
    """The limits that a model was made for."""
    return CommandLimits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)


def modelled_limits(settings: ModelledLimitsSettings | None, model: CommandLimits) -> CommandLimits:
    """Hard limits of command and rate: those of the settings; those of the model where they are left out.

    Raises:
        ControllerError: if the settings go beyond the model and do not say that they may.
    """
    if settings is None:
        return model
    limits = command_limits(settings)
    if not (settings.beyond_model or model.contains(limits)):
        raise ControllerError(
            f"limits: got {limits}, expected them within what the model was made for, {model}; "
            "limits.beyond_model: true allows more"
        )
    return limits


def _estimator_options(settings: EstimatorSettings) -> EstimatorOptions:
    return EstimatorOptions(
        sensor_sigma_deg=settings.sensor_sigma_deg,
        drift_sigma_deg=settings.drift_sigma_deg_per_sqrt_s,
        motion_sigma_deg=settings.motion_sigma_deg_per_sqrt_unit,
        delay_samples=settings.delay_samples,
        outlier_deg=settings.outlier_deg,
        dead_band_gain=settings.dead_band_gain_deg_per_unit,
        disturbance_limit_deg=settings.disturbance_limit_deg,
    )


def _weights(settings: WeightsSettings) -> Weights:
    low, high = settings.angle_lower_deg, settings.angle_upper_deg
    return Weights(
        tracking=settings.tracking,
        terminal=settings.terminal,
        rate=settings.rate,
        effort=settings.effort,
        soft_limit=settings.soft_limit,
        angle_limits_deg=(-math.inf if low is None else low, math.inf if high is None else high),
    )


def pid_gains(settings: PidSettings) -> PidGains:
    """The gains that the settings name."""
    return PidGains(
        kp=settings.kp_per_deg,
        ki=settings.ki_per_deg_s,
        kd=settings.kd_s_per_deg,
        filter_s=settings.filter_s,
        tracking_s=settings.tracking_s,
        dead_zone_deg=settings.dead_zone_deg,
    )


def _pid(settings: PidSettings, limits: CommandLimits, dt: float) -> Pid:
    return Pid(pid_gains(settings), limits, dt)
