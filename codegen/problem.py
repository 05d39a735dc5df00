"""Sizes, numbers and model steps of a controller for its export as C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.ctrl.build import build_controller, iterations_of, law_of, learning_pair
from hystmpc.ctrl.command import CommandLimits, limits_of_model, modelled_limits, narrowed_limits
from hystmpc.ctrl.estimation.observer import ANGLE_BOUND_DEG, OutputEstimator
from hystmpc.ctrl.feedback import REFERENCE_DEAD_ZONE_DEG, feedback_gains
from hystmpc.ctrl.law_tables import MoveBlocking
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc import FOLLOWING, Candidates, PredictiveLaw
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.models.chain import Chain, split
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.inverse.drive import DrivenInverse
from hystmpc.models.inverse.inverses import CompiledInverse, inverted_after_a_hold
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import Inverse, LoadedModel, Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.prediction.build import ControllerModel, controller_model, surrogate_backlash
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Mat, Vec

from .network import NetworkC, network_of
from .steps import Step


@dataclass(frozen=True, eq=False)
class Rest:
    """State at rest: offset + by_angle y + by_command u (S,), then `warmup` samples of the command held.

    For a chain, y is chosen so that its output equals the measured angle, see `chain_rest_source`.

    Operators next to a network are held for `companion_held` samples instead.
    """

    offset: Vec
    by_angle: Vec
    by_command: Vec
    warmup: int
    companion_held: int = 0


@dataclass(frozen=True, eq=False)
class ControllerProblem:
    """Data of a controller from which its C source is made.

    Attributes:
        sizes: of arrays, and which parts there are; whole numbers.
        numbers: scalars (), vectors and matrices of the algorithm, by the names of its macros in small letters.
        steps: model steps by name: `whole` (without a network), `middle`, and `front` and `back` where they exist.
        network: predictor in place of `whole`; `middle` is then the operator whose inverse is used.
    """

    sizes: Mapping[str, int]
    numbers: Mapping[str, float | Vec | Mat]
    steps: Mapping[str, Step]
    rest: Rest
    words: str
    network: NetworkC | None = None


def problem_of(settings: TipSettings, folder: Path) -> ControllerProblem:
    """Return the data of the controller that a `tip.yaml` describes.

    Raises:
        ExportError: where a part of it has no C; says what was got and what is supported.
        ModelError, ControllerError: as `TipController`.
    """
    controller = settings.controller
    if not isinstance(controller, LinearisedMpcSettings):
        raise ExportError(f"export-c: got controller.kind {controller.kind}, supported is linearised_mpc")
    _check(controller)
    if settings.inverse is not None:
        raise ExportError(f"export-c: got inverse {settings.inverse}, supported is the model's own: leave it out")
    loaded = load_model(model_path(settings.model, folder), start="conditioned")
    model = _of_chain(loaded, settings) if isinstance(loaded, ChainModel) else _of_network(loaded, settings)
    predictor, inverse = model.known.predictive
    facts = loaded.metadata
    limits = modelled_limits(settings.limits, limits_of_model(facts))
    build_controller(controller, predictor, inverse, limits)  # raises what is wrong with limits and ladder
    limits = narrowed_limits(limits, controller.limits)
    dt = predictor.dt
    steps = {name: Step(chain.transition, chain.values, dt) for name, chain in model.parts.items()}
    steps["middle"] = _inverted(inverse, steps["middle"])
    sizes, numbers = _law(controller, predictor, inverse, limits)
    counts = {name: step.size for name, step in steps.items()}
    network = model.network
    more = {} if network is None else network.numbers
    if network is not None:
        sizes |= network.sizes(max(sizes["candidates"], sizes["horizon"] + 1))
    return ControllerProblem(
        {
            "units": 0,
            **sizes,
            **{name: counts.get(name, 0) for name in ("front", "back")},
            "beside": counts["middle"],
            "chain": max(counts.values()),
            "states": model.rest.offset.size,
        },
        {
            **numbers,
            **more,
            "inverse_low": facts.command_limits.lower,
            "inverse_high": facts.command_limits.upper,
        },
        steps,
        model.rest,
        f"{settings.model}: {model.words}, {dt:g} s, {limits} [{facts.command_unit}]",
        network,
    )


@dataclass(frozen=True, eq=False)
class _ModelParts:
    """Model in parts; `known` is the model of the Python controller."""

    known: ControllerModel
    parts: Mapping[str, Chain]
    rest: Rest
    words: str
    network: NetworkC | None = None


def _of_chain(model: ChainModel, settings: TipSettings) -> _ModelParts:
    lag_s, facts = settings.actuator_lag_s, model.metadata
    parts = _parts(model.simulator.chain, lag_s)
    sizes = {name: chain.state_size for name, chain in parts.items()}
    if sizes["whole"] != sum(size for name, size in sizes.items() if name != "whole"):
        raise ExportError("export-c: got a delay with a longer store than its time needs, expected the store it needs")
    rest = _behind(parts["front"] if lag_s else None, _at_rest(facts), model.simulator.chain.rest_samples)
    words = " + ".join(operator.name for operator in parts["whole"].operators)
    return _ModelParts(controller_model(model, None, lag_s), parts, rest, words)


def _of_network(model: LoadedModel, settings: TipSettings) -> _ModelParts:
    from hystmpc.models.contract.load import OnnxModel  # onnxruntime is not loaded for a simulator

    assert isinstance(model, OnnxModel)
    network, facts, lag_s = network_of(model), model.metadata, settings.actuator_lag_s
    companion = surrogate_backlash(model)
    known, companion_held = controller_model(model, companion, lag_s), companion.metadata()
    parts = {"middle": companion.chain}
    if lag_s:
        parts["front"] = Chain(Lag(lag_s))
    shown = np.array([[0.0], [1.0], [0.0]])  # the measured angle, by both
    at_rest = np.concatenate([_at_rest(facts), shown, _at_rest(companion_held), shown], axis=1)
    rest = _behind(parts.get("front"), at_rest, facts.warmup_samples, companion_held.warmup_samples)
    return _ModelParts(known, parts, rest, f"{facts.kind} of {network.layers} x {network.hidden}", network)


def _inverted(inverse: Inverse, step: Step) -> Step:
    """Step to be inverted: one sample of the model, or its response to a held command, see `steady_inverse`."""
    inner = inverse.inner if isinstance(inverse, DrivenInverse) else inverse
    if not (inverted_after_a_hold(inner) and isinstance(inner, CompiledInverse)):
        return step
    assert isinstance(inner.predictor, CompiledPredictor)  # nothing else is inverted after a hold
    return Step(inner.predictor.transition, step.parameters, step.sample_s)


def _at_rest(facts: ModelMetadata) -> Mat:
    """Rows offset, slope by the angle and slope by the command (3, S) of a model's state at rest."""
    rule = facts.rule("conditioned")
    by_command = np.array(rule.by_command or (0.0,) * len(rule.offset))
    return np.array([rule.offset - rule.at_command * by_command, rule.slope, by_command])


def _behind(drive: Chain | None, at_rest: Mat, warmup: int, companion_held: int = 0) -> Rest:
    ahead = np.zeros((2, 0)) if drive is None else _rest_of(drive)
    return Rest(
        np.concatenate([ahead[0], at_rest[0]]),
        np.concatenate([np.zeros(ahead.shape[1]), at_rest[1]]),
        np.concatenate([ahead[1], at_rest[2]]),
        warmup,
        companion_held,
    )


def _check(controller: LinearisedMpcSettings) -> None:
    if controller.solver != "active_set":
        raise ExportError(f"export-c: got controller.solver {controller.solver}, supported is active_set: an exact one")
    if controller.estimator.sensor == "intermittent":
        raise ExportError("export-c: got estimator.sensor intermittent, supported are continuous and none")


def _parts(chain: Chain, lag_s: float) -> Mapping[str, Chain]:
    """Parts of a chain: the whole, the part inverted sample by sample, and dynamics on either side."""
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
    """Rows offset and slope (2, S) of a drive's state at rest as a function of the held input."""
    at = [np.asarray(drive.rest(u, u, ca.DM(drive.values))).ravel() for u in (0.0, 1.0)]
    return np.stack([at[0], at[1] - at[0]])


def _law(
    settings: LinearisedMpcSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> tuple[dict[str, int], dict[str, Any]]:
    """Sizes and numbers of control law, estimator and fallbacks."""
    learned = learning_pair(settings, predictor, inverse)
    law = law_of(settings.model_copy(update={"supervisor": None}), *learned, limits)
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
        "iterations": iterations_of(settings, inverse),
        "safe_known": int(settings.ladder.safe_command is not None),
        "stop_after": settings.ladder.stop_after_failures,
        "most_missing": settings.bridged_samples(dt),
        "senses": int(settings.estimator.sensor == "continuous"),
        "learns": int(settings.adaptation is not None),
        "supervised": int(settings.supervisor is not None),
        "filters": 1,
        **_program_sizes(settings, horizon, dt),
    }
    observer = settings.estimator.observer(predictor)
    parts_of_law: list[Mapping[str, Any]] = [observer.numbers()] if isinstance(observer, OutputEstimator) else []
    if isinstance(learned[0], LearnedPredictor):
        parts_of_law.append(learned[0].filters(delay).numbers())
    if settings.supervisor is not None:
        parts_of_law.append(_supervisor(settings, predictor))
    for more in (numbers, *parts_of_law):
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
        "qp_moves": count,
        "qp_size": count + slack,
        "qp_rows": 2 * count + between + slack,
    }


def _blocking(settings: LinearisedMpcSettings, horizon: int, dt: float) -> dict[str, Any]:
    """Starts, ends and matrix M of the blocks, and the constant part of the program's Hessian."""
    blocks = settings.blocks(dt)
    assert blocks is not None
    blocking = MoveBlocking(blocks, horizon)
    return {
        "block_starts": blocking.starts,
        "block_ends": blocking.ends,
        "blocking": blocking.matrix,
        "block_constant": blocking.constant(settings.weights),
    }


def _supervisor(settings: LinearisedMpcSettings, predictor: Predictor) -> dict[str, Any]:
    assert settings.supervisor is not None
    gains = feedback_gains(settings.supervisor, predictor)
    return {
        "inverse_pid_above": settings.supervisor.inverse_pid_above,
        "pid_above": settings.supervisor.pid_above,
        "pid_kp": gains.kp_per_deg,
        "pid_ki": gains.ki_per_deg_s,
        "pid_kd": gains.kd_s_per_deg,
        "pid_filter_s": gains.filter_s,
        "pid_tracking_s": gains.tracking_s,
        "pid_dead_zone": gains.dead_zone_deg,
        "reference_dead_zone": REFERENCE_DEAD_ZONE_DEG,
    }
