"""What a controller's C is made from: its sizes, its numbers, its steps; and what cannot be exported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.ctrl.build import build_controller, known_model, limits_of_model, modelled_limits
from hystmpc.ctrl.estimation.observer import ANGLE_BOUND_DEG, OutputEstimator
from hystmpc.ctrl.feedback.inverse import REFERENCE_DEAD_ZONE_DEG
from hystmpc.ctrl.handover import gains_for
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.ctrl.linearised.program import MoveBlocking
from hystmpc.ctrl.mpc import PredictiveLaw
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.ctrl.planning import FOLLOWING, Candidates
from hystmpc.models.chain import Chain
from hystmpc.models.inverse.drive import split
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Mat, Vec

from .steps import Step


@dataclass(frozen=True, eq=False)
class Rest:
    """The state at rest: offset + by_angle y + by_command u (S,), then `warmup` samples of the command held."""

    offset: Vec
    by_angle: Vec
    by_command: Vec
    warmup: int


@dataclass(frozen=True, eq=False)
class Problem:
    """One controller in numbers.

    Attributes:
        sizes: of arrays, and which parts there are; whole numbers.
        numbers: scalars (), vectors and matrices of the algorithm, by the names of its macros in small letters.
        steps: of `whole`, `middle`, and where they are, `front` and `back`.
        rest: how a state at rest is made.
        words: what it is, for the head of the file.
    """

    sizes: Mapping[str, int]
    numbers: Mapping[str, float | Vec | Mat]
    steps: Mapping[str, Step]
    rest: Rest
    words: str


def problem_of(settings: TipSettings, folder: Path) -> Problem:
    """The controller of a `tip.yaml`.

    Raises:
        ExportError: where a part of it has no C; says what was got and what is supported.
        ModelError, ControllerError: as `TipController`.
    """
    controller = settings.controller
    if not isinstance(controller, LinearisedMpcSettings):
        raise ExportError(f"export-c: got controller.kind {controller.kind}, supported is linearised_mpc")
    _check(controller)
    model = load_model(model_path(settings.model, folder), start="conditioned")
    if not isinstance(model, ChainModel):
        raise ExportError(
            f"export-c: got a model of kind {model.metadata.kind} in an .onnx file, supported are simulators (.yaml)"
        )
    if settings.inverse is not None:
        raise ExportError(f"export-c: got inverse {settings.inverse}, supported is the model's own: leave it out")
    parts = _parts(model.simulator.chain, settings.actuator_lag_s)
    predictor, inverse = known_model(model, None, settings.actuator_lag_s).predictive
    limits = modelled_limits(settings.limits, limits_of_model(model.metadata))
    build_controller(controller, predictor, inverse, limits)  # raises what is wrong with limits and ladder
    own = controller.limits
    limits = limits if own is None else own.build()
    dt, facts = predictor.dt, model.metadata
    steps = {name: Step(chain.transition, chain.values, dt) for name, chain in parts.items()}
    sizes, numbers = _law(controller, predictor, inverse, limits)
    counts = {name: step.size for name, step in steps.items()}
    ends = {name: counts.get(name, 0) for name in ("front", "back")}
    if counts["whole"] != counts["middle"] + sum(ends.values()):
        raise ExportError("export-c: got a delay with a longer store than its time needs, expected the store it needs")
    rule = facts.rule("conditioned")
    ahead = _rest_of(parts["front"]) if settings.actuator_lag_s else np.zeros((2, 0))
    none = np.zeros(len(rule.offset))
    return Problem(
        {**sizes, **ends, "states": counts["whole"]},
        {
            **numbers,
            "inverse_low": facts.command_limits.lower,
            "inverse_high": facts.command_limits.upper,
        },
        steps,
        Rest(
            np.concatenate([ahead[0], rule.offset]),
            np.concatenate([np.zeros(ahead.shape[1]), rule.slope]),
            np.concatenate([ahead[1], none]),
            facts.warmup_samples,
        ),
        f"{settings.model}: {' + '.join(operator.name for operator in parts['whole'].operators)}, "
        f"{dt:g} s, {limits} [{facts.command_unit}]",
    )


def _check(controller: LinearisedMpcSettings) -> None:
    if controller.solver != "daqp":
        raise ExportError(f"export-c: got controller.solver {controller.solver}, supported is daqp: an exact one")
    if controller.estimator.sensor == "intermittent":
        raise ExportError("export-c: got estimator.sensor intermittent, supported are continuous and none")


def _parts(chain: Chain, lag_s: float) -> Mapping[str, Chain]:
    """The whole, what is inverted sample by sample, and dynamics on either side of it."""
    front, middle, back = split(chain)
    if lag_s and (front or back):
        words = ", ".join(operator.name for operator in (*front, *back))
        raise ExportError(
            f"export-c: got actuator_lag_s {lag_s:g} beside {words} in the model, supported is one of them: put the "
            "lag into the model's file"
        )
    ahead: Sequence[Operator] = (Lag(lag_s),) if lag_s else front
    whole = Chain(chain.core, (*ahead, *middle.before), chain.after)
    sides = {"front": ahead, "back": back}
    return {
        "whole": whole,
        "middle": middle,
        **{name: Chain(side[-1], before=tuple(side[:-1])) for name, side in sides.items() if side},
    }


def _rest_of(drive: Chain) -> Mat:
    """Rows offset and slope (2, S) of a drive's state at rest, by the input that is held."""
    at = [np.asarray(drive.rest(u, u, ca.DM(drive.values))).ravel() for u in (0.0, 1.0)]
    return np.stack([at[0], at[1] - at[0]])


def _law(
    settings: LinearisedMpcSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> tuple[dict[str, int], dict[str, Any]]:
    """Sizes and numbers of law, estimator and fallbacks."""
    learned = settings.model_pair(predictor, inverse)
    law = settings.model_copy(update={"handover": None}).law(*learned, limits)
    assert isinstance(law, PredictiveLaw)
    delay, dt, horizon = settings.estimator.delay_samples, predictor.dt, law.horizon
    if horizon < 2:
        raise ExportError(f"export-c: got controller.horizon {horizon}, supported are 2 samples or more")
    numbers: dict[str, Any] = {
        "dt_s": dt,
        "lower": limits.lower,
        "upper": limits.upper,
        "reach": limits.rate * dt,
        "angle_bound": ANGLE_BOUND_DEG,
        "rest_tolerance": settings.estimator.rest_tolerance_deg,
        "slope": law.slope,
        "safe": settings.ladder.safe_command or 0.0,
        **law.rule.numbers(),
        **_weights(settings, horizon),
    }
    sizes = {
        "horizon": horizon,
        "delay": delay,
        "under_way": delay + 1,
        "reference": horizon + delay,
        "candidates": FOLLOWING + Candidates(*learned, limits, horizon).searching,
        "iterations": settings.iterations,
        "safe_known": int(settings.ladder.safe_command is not None),
        "stop_after": settings.ladder.stop_after_failures,
        "most_missing": settings.bridged_samples(dt),
        "senses": int(settings.estimator.sensor == "continuous"),
        "learns": int(settings.adaptation is not None),
        "hands_over": int(settings.handover is not None),
        "filters": 1,
        **_program_sizes(settings, horizon, dt),
    }
    observer = settings.estimator.observer(predictor)
    found: list[Mapping[str, Any]] = [observer.numbers()] if isinstance(observer, OutputEstimator) else []
    if isinstance(learned[0], LearnedPredictor):
        found.append(learned[0].filters(delay).numbers())
    if settings.handover is not None:
        found.append(_handover(settings, predictor))
    for more in (numbers, *found):
        sizes |= {name: value for name, value in more.items() if isinstance(value, int)}
        numbers = numbers | dict(more)
    if sizes["blocks"]:
        numbers |= _blocking(settings, horizon, dt)
    return sizes, {name: value for name, value in numbers.items() if not isinstance(value, int)}


def _weights(settings: LinearisedMpcSettings, horizon: int) -> dict[str, Any]:
    weights = settings.weights
    low, high = weights.angle_limits_deg
    return {
        "tracking": weights.over(horizon),
        "rate_weight": weights.rate,
        "effort_weight": weights.effort,
        "soft_weight": weights.soft_limit,
        "angle_low": low,
        "angle_high": high,
    }


def _program_sizes(settings: LinearisedMpcSettings, horizon: int, dt: float) -> dict[str, int]:
    blocks, soft = settings.blocks(dt), settings.weights.limits_angle
    count = horizon if blocks is None else len(blocks)
    between = 0 if blocks is None else horizon - count
    slack = horizon if soft else 0
    return {
        "blocks": 0 if blocks is None else count,
        "soft": int(soft),
        "qp_size": count + slack,
        "qp_rows": 2 * count + between + slack,
    }


def _blocking(settings: LinearisedMpcSettings, horizon: int, dt: float) -> dict[str, Any]:
    """Starts and ends of the blocks, M, and what of the program's Hessian never changes."""
    blocks = settings.blocks(dt)
    assert blocks is not None
    blocking = MoveBlocking(blocks, horizon)
    matrix = blocking.matrix
    moves = np.diff(matrix, axis=0, prepend=0.0)
    weights = settings.weights
    return {
        "block_starts": blocking.starts,
        "block_ends": blocking.ends,
        "blocking": matrix,
        "block_constant": 2.0 * (weights.rate * moves.T @ moves + weights.effort * matrix.T @ matrix),
    }


def _handover(settings: LinearisedMpcSettings, predictor: Predictor) -> dict[str, Any]:
    assert settings.handover is not None
    gains = gains_for(settings.handover, predictor)
    return {
        "inverse_pid_above": settings.handover.inverse_pid_above,
        "pid_above": settings.handover.pid_above,
        "pid_kp": gains.kp_per_deg,
        "pid_ki": gains.ki_per_deg_s,
        "pid_kd": gains.kd_s_per_deg,
        "pid_filter_s": gains.filter_s,
        "pid_tracking_s": gains.tracking_s,
        "pid_dead_zone": gains.dead_zone_deg,
        "reference_dead_zone": REFERENCE_DEAD_ZONE_DEG,
    }
