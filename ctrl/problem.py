"""The problem that the engine's controller is given: model, sensor, law and limits as structs of core/controller.h."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hystmpc.core.structs import Struct, constants, fields_of, struct
from hystmpc.models.inverse.drive import DrivenInverse
from hystmpc.models.inverse.inverses import inverted_after_a_hold
from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.trials.errors import ControllerError

from .command import CommandLimits, attempt, narrowed_limits
from .config import AnyControllerSettings
from .estimation.observer import Observer
from .feedback import (
    REFERENCE_DEAD_ZONE_DEG,
    FeedforwardSettings,
    InversePidControllerSettings,
    PidControllerSettings,
    PidSettings,
    feedback_gains,
)
from .law import LawPart, LawSettings
from .law_tables import MoveBlocking, law_over
from .learning.predictor import LearnedInverse, LearnedPredictor
from .mpc_settings import LinearisedMpcSettings, PredictiveSettings, SamplingMpcSettings, WeightsSettings

CHANGES = 1000
"""Greatest number of changes of the active set in one program, which limits the time of its solution."""
_FOLLOWING, _STEPS = 5, 8  # candidates before those that only search; small steps either way
_REFINED = 2  # iterations from a plan that is late along a motion
_TOLERANCES_DEG = 0.01, 0.003  # of a hold: far model, close model
_ALONE_DEG = 0.001, 0.001  # without a sensor
_WORTH_DEG, _WORTH_ALONE_DEG = 0.1, 0.01  # nearer by this: worth to leave a hold for before the reference moves
_TOLERANCE_IN_STEPS_DEG = 0.03  # where readings have steps
_LEAVE_SIGMAS = 5.0  # the difference of two independent estimates of one disturbance exceeds this once in 10^4 samples
_LEAST, _KEPT = 0.05, 0.3  # least share of a direction in the noise; of the elites that take part again

# Of the inverse over a preview: weights on moves, at the sample time of the paper.
_RATE_WEIGHT = 0.01  # at 25 Hz [deg^2 per squared command unit]: negligible against an angle error
_STEADY_RATE_WEIGHT = 3.0  # for models whose exact inverse oscillates: the weight on moves suppresses it
_BASE_DT_S = 0.04
_INVERSE_ITERATIONS = 2

_WORD = 2**64


def problem_of(
    settings: AnyControllerSettings | LawSettings,
    predictor: Predictor,
    inverse: Inverse,
    limits: CommandLimits,
    *,
    observer: Observer | None = None,
    law: LawPart | None = None,
    solve: Callable[..., int] | None = None,
) -> Struct:
    """Return the `hystmpc_problem` of the controller that `settings` describe.

    Args:
        settings: of any kind.
        predictor, inverse: of the model, with or without a learned part.
        limits: hard limits of the device; `settings.limits` may narrow them.
        observer: of state and disturbance; that of the settings where left out.
        law: one that is written in Python.
        solve: solution of quadratic programs in Python, see `hystmpc_planner`.

    Raises:
        ControllerError: if the settings contradict each other or go beyond the device's limits.
    """
    settings = settings.resolved()
    limits, ladder = narrowed_limits(limits, settings.limits), settings.ladder
    if ladder.safe_command is not None and not limits.lower <= ladder.safe_command <= limits.upper:
        raise ControllerError(
            f"ladder: got safe_command {ladder.safe_command}, expected one within {limits.lower} to {limits.upper}"
        )
    dt, missing = predictor.dt, settings.bridged_samples(predictor.dt)
    if not (math.isfinite(dt) and dt > 0) or missing < 0:
        raise ControllerError(f"controller: got dt {dt}, max_missing_samples {missing}, expected > 0 s and >= 0")
    device = _Modelled(predictor, inverse, limits, dt)
    observer = observer or settings.estimator.observer(device.known)
    return struct(
        "hystmpc_problem",
        dt_s=dt,
        lower=limits.lower,
        upper=limits.upper,
        reach=limits.rate * dt,
        safe=math.nan if ladder.safe_command is None else ladder.safe_command,
        stop_after=ladder.stop_after_failures,
        most_missing=missing,
        falls_back_on_inverse=settings.falls_back_on_inverse,
        model=_model(settings, device) if observer.has_model else None,
        sensing=observer.part,
        law=_law(settings, device, solve) if law is None else outside_law(law),
    )


def outside_law(law: LawPart) -> Struct:
    """Return the `hystmpc_control_law` of a law that is written in Python."""
    return struct("hystmpc_control_law", kind=constants()["HYSTMPC_PROPOSED"], horizon=law.law.horizon, propose=law)


@dataclass(frozen=True, eq=False)
class _Modelled:
    """Model and hard limits of a controller; `known` and `inverted` are the model's own, without a learned part."""

    predictor: Predictor
    inverse: Inverse
    limits: CommandLimits
    dt: float

    @property
    def known(self) -> Predictor:
        return self.predictor.model if isinstance(self.predictor, LearnedPredictor) else self.predictor

    @property
    def inverted(self) -> Inverse:
        return self.inverse.inverse if isinstance(self.inverse, LearnedInverse) else self.inverse

    @property
    def first_guess(self) -> bool:
        return is_first_guess(self.inverse)

    @property
    def reach(self) -> float:
        return self.limits.rate * self.dt

    @property
    def slope(self) -> float:
        """Static gain [deg per command unit]; 0 where the model fails, as one may where no plan ever is."""
        return attempt(lambda: static_gain(self.known))[0] or 0.0


def _model(settings: LawSettings, device: _Modelled) -> Struct:
    learned, learner = device.predictor, None
    if isinstance(settings, PredictiveSettings) and settings.adaptation is not None:
        if not isinstance(learned, LearnedPredictor):
            learned = LearnedPredictor(learned, settings.adaptation)
        learner = learned.filters(settings.estimator.delay_samples).struct()
    return struct("hystmpc_model", predictor=device.known.part, inverse=device.inverted.part, learner=learner)


def _law(settings: LawSettings, device: _Modelled, solve: Callable[..., int] | None) -> Struct:
    if isinstance(settings, PredictiveSettings):
        return _predictive(settings, device, solve)
    kinds = constants()
    if isinstance(settings, PidControllerSettings):
        gains = _gains(settings.gains, device.dt)
        return struct("hystmpc_control_law", kind=kinds["HYSTMPC_PID"], horizon=1, gains=gains)
    if not isinstance(settings, FeedforwardSettings):
        raise ControllerError(f"controller: got {type(settings).__name__}, expected a class with a method `law`")
    fed_back = isinstance(settings, InversePidControllerSettings)
    late = isinstance(device.inverted, DrivenInverse) or device.first_guess
    horizon = settings.preview if late else 1
    return struct(
        "hystmpc_control_law",
        kind=kinds["HYSTMPC_FEEDFORWARD_PID" if fed_back else "HYSTMPC_FEEDFORWARD"],
        horizon=horizon,
        planner=_preview(device, horizon) if late else None,
        rate_weight=_preview_rate(device),
        candidates=candidates_over(horizon),
        angle_low=-math.inf,
        angle_high=math.inf,
        gains=_gains(settings.gains, device.dt) if isinstance(settings, InversePidControllerSettings) else None,
        dead_zone=settings.reference_dead_zone_deg,
    )


def _predictive(settings: PredictiveSettings, device: _Modelled, solve: Callable[..., int] | None) -> Struct:
    horizon, supervisor = settings.preview_samples(device.dt), settings.supervisor
    low, high = settings.weights.angle_limits_deg
    more: dict[str, Any] = {}
    weights = settings.weights
    if supervisor is not None:
        more = {
            "supervised": 1,
            "inverse_pid_above": supervisor.inverse_pid_above,
            "pid_above": supervisor.pid_above,
            "gains": _gains(feedback_gains(supervisor, device.known), device.dt),
            "dead_zone": REFERENCE_DEAD_ZONE_DEG,
        }
    return struct(
        "hystmpc_control_law",
        kind=constants()["HYSTMPC_PREDICTIVE"],
        horizon=horizon,
        planner=_planner(settings, device, horizon, solve),
        candidates=candidates_over(horizon),
        rate_weight=weights.rate,
        close_rate_weight=weights.rate if device.first_guess else weights.rate_close,
        angle_low=low,
        angle_high=high,
        slope=device.slope,
        hold=_hold(settings, device),
        **more,
    )


def candidates_over(horizon: int) -> int:
    """Return the greatest number of candidate plans over a horizon: five, reversals and small steps either way."""
    lengths = [2**i for i in range(1, horizon.bit_length()) if 2**i <= max(horizon // 2, 2)]
    return _FOLLOWING + 2 * (len(lengths) + _STEPS)


def _hold(predictive: PredictiveSettings, device: _Modelled) -> Struct:
    """Return the rule of holds; without a sensor no reading has steps, and the model alone says when to move."""
    settings, dt = predictive.hold, device.dt
    alone, noise = predictive.estimator.sensor == "none", device.known.noise
    step = noise.sensor_resolution_deg if noise and not alone else 0.0
    far, close = (_ALONE_DEG if alone else _TOLERANCES_DEG) if step == 0.0 else (_TOLERANCE_IN_STEPS_DEG,) * 2
    if settings.tolerance_deg is not None:
        far = close = settings.tolerance_deg
    return struct(
        "hystmpc_hold",
        tolerance=far,
        close_tolerance=close,
        worth=_WORTH_ALONE_DEG if alone else _WORTH_DEG,
        step=step,
        sigmas=_LEAVE_SIGMAS,
        patience=max(round(settings.patience_s / dt), 1),
        settle_after=round(settings.settle_after_s / dt),
        settle=round(settings.settle_s / dt),
    )


def _gains(gains: PidSettings, dt: float) -> Struct:
    if gains.tracking_s < dt:
        raise ControllerError(f"pid: got tracking_s {gains.tracking_s}, expected at least the sample time {dt} s")
    return struct(
        "hystmpc_gains",
        kp=gains.kp_per_deg,
        ki=gains.ki_per_deg_s,
        kd=gains.kd_s_per_deg,
        filter_s=gains.filter_s,
        tracking_s=gains.tracking_s,
        dead_zone=gains.dead_zone_deg,
    )


def iterations_of(settings: PredictiveSettings, inverse: Inverse) -> tuple[int, int]:
    """Return the planner's iterations per step, and those where the model is close to the device.

    They are at least the two of the inverse over a preview for a first-guess inverse, see `steady_inverse`. A plan on a
    close model is finished by a second one; on a model that errs it would only follow the error.
    """
    usual = max(settings.iterations, _REFINED) if is_first_guess(inverse) else settings.iterations
    return usual, max(usual, _REFINED)


def is_first_guess(inverse: Inverse) -> bool:
    """Return whether an inverse is only a first guess of a plan, since that of each sample oscillates."""
    return inverted_after_a_hold(inverse.inverse if isinstance(inverse, LearnedInverse) else inverse)


def _planner(settings: PredictiveSettings, device: _Modelled, horizon: int, solve: Callable[..., int] | None) -> Struct:
    kinds, blocks, kind, sampling = constants(), None, "HYSTMPC_LINEARISED", None
    if isinstance(settings, LinearisedMpcSettings):
        blocks = settings.blocks(device.dt)
        kind = "HYSTMPC_LINEARISED" if settings.solver == "active_set" else "HYSTMPC_SOLVED"
    else:
        assert isinstance(settings, SamplingMpcSettings)
        kind = "HYSTMPC_CROSS_ENTROPY" if settings.method == "cem" else "HYSTMPC_PATH_INTEGRAL"
        sampling = _sampling(settings, device, horizon)
    usual, close = iterations_of(settings, device.inverted)
    return struct(
        "hystmpc_planner",
        kind=kinds[kind],
        iterations=usual,
        close_iterations=close,
        changes=CHANGES,
        law=law_over(settings.weights.discounted(device.first_guess), horizon, device.limits, device.dt, blocks),
        sampling=sampling,
        solve=solve,
    )


def _preview_rate(device: _Modelled) -> float:
    """Weight on moves of the inverse over a preview."""
    rate = _STEADY_RATE_WEIGHT if device.first_guess else _RATE_WEIGHT
    return rate * (_BASE_DT_S / device.dt) ** 2


def _preview(device: _Modelled, horizon: int) -> Struct:
    """Inverse over a preview: argmin over admissible u of sum_k (theta_k(u) - r_k)^2, with a small weight on moves.

    It is the problem of the linearised controller without a disturbance. An inverse sample by sample would send u = v +
    (w - v) / a to a lag with step response a < 1, which amplifies every deviation; a delay has no such inverse.
    """
    weights = WeightsSettings(effort=0.0).discounted(device.first_guess)
    return struct(
        "hystmpc_planner",
        kind=constants()["HYSTMPC_LINEARISED"],
        iterations=_INVERSE_ITERATIONS,
        close_iterations=_INVERSE_ITERATIONS,
        changes=CHANGES,
        law=law_over(weights, horizon, device.limits, device.dt),
    )


def _sampling(settings: SamplingMpcSettings, device: _Modelled, horizon: int) -> Struct:
    """Distribution of smooth random plans in blocked moves, u = p + sigma M F w, from as few normals as blocks."""
    blocks, samples = settings.blocks(device.dt), settings.samples
    blocking = MoveBlocking(blocks, horizon)
    left, sizes, _ = np.linalg.svd(settings.noise.matrix(horizon)[blocking.ends])
    strengths = np.full(len(left), _LEAST * sizes[0])
    strengths[: sizes.size] = np.maximum(sizes, strengths[: sizes.size])
    factor = left * strengths
    sigma = settings.deviation(device.reach)
    elites = min(max(2, math.ceil(settings.elites * samples)), samples)
    single, weights = len(blocks) == horizon, settings.weights.discounted(device.first_guess)
    return struct(
        "hystmpc_sampling",
        samples=samples,
        size=len(blocks),
        elites=elites,
        kept=math.ceil(_KEPT * elites),
        seed=[settings.seed % _WORD, settings.seed // _WORD % _WORD],
        temperature=settings.temperature,
        sigma=sigma,
        least_sigma=settings.finest * sigma,
        sigmas=sigma * np.geomspace(1.0, settings.finest, samples),
        shape=(blocking.matrix @ factor).T,
        whitening=np.linalg.inv(factor).T,
        fitted=law_over(weights, horizon, device.limits, device.dt, None if single else blocks),
    )


_WRITTEN = {
    "hystmpc_control_law": "a law",
    "hystmpc_planner": "a solver of quadratic programs",
    "hystmpc_outside": "a model or an inverse",
}


def written_in(part: Struct) -> str:
    """Return what of a controller is written in Python, in words; empty if nothing."""
    for field in fields_of(part.name):
        value = part.fields.get(field.name)
        if value is not None and field.arguments is not None:
            return _WRITTEN.get(part.name, part.name)
        if isinstance(value, Struct) and (inner := written_in(value)):
            return inner
    return ""
