"""Predictors and inverses of a model for a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.core.structs import Struct
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..chain import Chain, split
from ..connections import operators_of, rest_of
from ..contract.metadata import ModelMetadata
from ..fronts import EnginePredictor, pair_inputs, pair_part, pair_rest
from ..inverse.drive import Drive, DrivenInverse
from ..inverse.inverses import (
    AccompaniedPredictor,
    CompanionInverse,
    MappedPredictor,
    TrainedInverse,
    check_inverse_map,
    steady_inverse,
)
from ..load import load_model
from ..model import Inverse, InvertiblePredictor, LoadedModel, Predictor
from ..operators.dynamics import Lag
from ..operators.operator import Operator
from ..simulator import ChainModel, Simulator, simulator_for
from .compiled import CompiledPredictor

if TYPE_CHECKING:
    from ..contract.load import OnnxModel

# Scalar operations of a step beyond which onnxruntime's matrix products are faster; a chain of operators has tens. 256
# roll-outs of an LSTM take as long in the engine as there with 536 operations, and eight times as long with 2,244.
_COMPILED_INSTRUCTIONS = 500


def predictor_for(model: LoadedModel) -> Predictor:
    """Fastest predictor for a model.

    The engine for operator chains, small elementwise graphs, `lstm`, `gru` and `play_kernel`; else onnxruntime and
    CasADi.

    Raises:
        ModelError: if the model is an inverse map.
    """
    if model.metadata.inverted:
        raise ModelError(
            f"the model maps {model.metadata.command_unit} to {model.metadata.angle_unit}, expected a forward model; "
            "an inverse map is given as `inverse`"
        )
    if isinstance(model, ChainModel):
        return CompiledPredictor.of_simulator(model.simulator)
    return _exported_predictor(model)


def _exported_predictor(model: LoadedModel) -> Predictor:
    """Predictor of an ONNX file, whose libraries are loaded here only."""
    from ..contract.load import OnnxModel

    assert isinstance(model, OnnxModel)
    if model.metadata.connections:
        return _connected_predictor(model)
    if model.metadata.kind in ("lstm", "gru"):
        from .exported import recurrent_predictor

        return recurrent_predictor(model)
    if model.metadata.kind == "play_kernel":
        from ..play_kernel.predictor import PlayKernelPredictor

        return PlayKernelPredictor.of_model(model)
    function = model.casadi_function()
    if function.is_a("SXFunction") and function.n_instructions() <= _COMPILED_INSTRUCTIONS:
        return CompiledPredictor.of_function(function, model.metadata)
    from .exported import OnnxPredictor

    return OnnxPredictor(model)


def _connected_predictor(model: OnnxModel) -> Predictor:
    """Predictor of a model with operators in series or in parallel: the fastest one for each part."""
    facts, rest = model.metadata, predictor_for(rest_of(model))
    if facts.connections[0].way == "series":
        return SeriesPredictor(Drive(operators_of(facts).operators, facts), rest)
    return ParallelPredictor(CompiledPredictor.of_simulator(_operators_of(facts)), rest)


def _operators_of(facts: ModelMetadata) -> Simulator:
    return simulator_for(operators_of(facts), facts, "operators of a connection")


Pair = tuple[Predictor, Inverse]


@dataclass(frozen=True, eq=False)
class ControllerModel:
    """Model for controllers: predictors, each with an inverse of the same memory.

    Attributes:
        feedforward: of controllers that only invert: the same for a model that has an inverse and for an inverse map,
            else the companion operator. With a correction by the network at every sample, as for the first guess of
            predictive controllers, that inverse would oscillate across the dead band.
    """

    facts: ModelMetadata
    predictive: Pair
    feedforward: Pair

    def behind(self, operators: Sequence[Operator], facts: ModelMetadata) -> ControllerModel:
        """Controller model behind a drive of operators in series; `facts` are those of the whole."""
        drive = Drive(operators, facts)

        def driven(predictor: Predictor, inverse: Inverse) -> Pair:
            return SeriesPredictor(drive, predictor), DrivenInverse(inverse, predictor, drive)

        return ControllerModel(facts, driven(*self.predictive), driven(*self.feedforward))


def controller_model(
    model: LoadedModel | Path | str,
    inverse: Simulator | LoadedModel | Path | str | None = None,
    actuator_lag_s: float = 0.0,
) -> ControllerModel:
    """Predictors and inverses of a model for controllers.

    A compiled model is inverted exactly, and lags and delays of a chain or of a drive over a preview (`DrivenInverse`).
    For any other, a companion is inverted: the given simulator, the operators connected in parallel, or a backlash
    fitted to the model's free run. A given model has to be an inverse map and is evaluated directly.

    Args:
        model: a file, or a model opened with the start "conditioned".
        inverse: simulator that is inverted in the model's place, or an inverse map; a simulator's file is converted to
            the model's sample time.
        actuator_lag_s: first-order lag of the command that the model does not contain [s]; 0 for none.

    Raises:
        ModelError: if a file cannot be used, the model's output is not in deg, or an inverse map is a forward model or
            of another unit or sample time.
        FitError: if no companion is given and none can be fitted.
    """
    opened = model if isinstance(model, LoadedModel) else load_model(model, "conditioned")
    facts = opened.metadata
    if facts.angle_unit != "deg" and not facts.inverted:
        raise ModelError(
            f"the model maps {facts.command_unit} to {facts.angle_unit}, expected an output in deg: a tip is "
            "steered by its angle"
        )
    companion = _companion_in(inverse, facts.dt_s) if isinstance(inverse, Path | str) else inverse
    pairs = _pairs(opened, companion)
    return pairs.behind((Lag(actuator_lag_s),), facts) if actuator_lag_s else pairs


def _companion_in(file: Path | str, dt_s: float) -> Simulator | LoadedModel:
    given = load_model(file)
    if not isinstance(given, ChainModel):
        return given
    simulator = given.simulator.at_sample_time(dt_s)
    return ChainModel(simulator) if given.metadata.inverted else simulator


def _pairs(model: LoadedModel, companion: Simulator | LoadedModel | None) -> ControllerModel:
    facts = model.metadata
    connection = next(iter(facts.connections), None)
    if connection is not None and connection.way == "series" and companion is None:
        return _pairs(rest_of(model), None).behind(operators_of(facts).operators, facts)
    predictor = predictor_for(model)
    low, high = facts.command_limits.lower, facts.command_limits.upper  # search range of an inverse
    if isinstance(companion, LoadedModel):
        check_inverse_map(companion.metadata, facts)
        mapped = MappedPredictor(predictor, companion)
        pair: Pair = mapped, TrainedInverse(mapped, low, high)
    elif isinstance(model, ChainModel) and companion is None:
        pair = predictor, inverse_of_chain(model.simulator)
    elif isinstance(predictor, InvertiblePredictor) and companion is None:
        pair = predictor, steady_inverse(predictor, low, high)
    else:
        if companion is None:
            companion = _companion_of(model)
        side = CompiledPredictor.of_simulator(companion)
        both = AccompaniedPredictor(predictor, side)
        alone = _pairs(ChainModel(companion, "conditioned"), None).feedforward
        return ControllerModel(facts, (both, CompanionInverse(both, steady_inverse(side, low, high))), alone)
    return ControllerModel(facts, pair, pair)


def _companion_of(model: LoadedModel) -> Simulator:
    """Operators connected in parallel, or a backlash fitted to the model's free run."""
    if model.metadata.connections:
        return _operators_of(model.metadata)
    return surrogate_backlash(model)


def inverse_of_chain(simulator: Simulator) -> Inverse:
    """Inverse of a simulator, with the memory of its `CompiledPredictor`."""
    front, middle, back = split(simulator.chain)
    inner = CompiledPredictor.of_simulator(replace(simulator, chain=middle))
    inverse = steady_inverse(inner, simulator.command_limits.lower, simulator.command_limits.upper)
    if not front and not back:
        return inverse
    drives = [Drive(side, simulator.metadata()) if side else None for side in (front, back)]
    return DrivenInverse(inverse, inner, *drives)


@final
class SeriesPredictor(EnginePredictor):
    """Model behind a drive: theta = model(v), v = drive(u).

    d theta / d u = (d theta / d v) (d v / d u). The state is [drive state, model state].
    """

    def __init__(self, drive: Drive, predictor: Predictor) -> None:
        self._as(predictor)
        self._drive, self._predictor = drive.predictor, predictor
        self.inputs, self.input_states = pair_inputs(self._drive, predictor)

    @property
    def state_size(self) -> int:
        return self._drive.state_size + self._predictor.state_size

    @cached_property
    def part(self) -> Struct:
        return pair_part("SERIES", self._drive, self._predictor, self.state_size)

    @property
    def rest_part(self) -> Struct:
        return pair_rest(self._drive, self._predictor)

    def initial(self, y: float, u: float) -> Vec:
        return np.concatenate([self._drive.initial(u, u), self._predictor.initial(y, u)])


@final
class ParallelPredictor(EnginePredictor):
    """Sum of two models with the same command: theta = first(u) + second(u).

    The state is [state of the first, state of the second]. At rest the first one shows the measured angle.
    """

    def __init__(self, first: Predictor, second: Predictor) -> None:
        self.dt, self.command_range, self.noise = first.dt, first.command_range, second.noise
        self.model_sigma_deg = second.model_sigma_deg
        self.first, self.second, self.size = first, second, first.state_size
        self.inputs, self.input_states = pair_inputs(first, second)

    @property
    def state_size(self) -> int:
        return self.size + self.second.state_size

    @cached_property
    def part(self) -> Struct:
        return pair_part("PARALLEL", self.first, self.second, self.state_size)

    @property
    def rest_part(self) -> Struct:
        return pair_rest(self.first, self.second)

    def initial(self, y: float, u: float) -> Vec:
        return np.concatenate([self.first.initial(y, u), self.second.initial(0.0, u)])


def surrogate_backlash(model: LoadedModel) -> Simulator:
    """Backlash simulator fitted to the model's free run over `probe_commands` after the first flexure.

    Raises:
        FitError: if the model's angle does not rise with the command.
    """
    from hystmpc.trials.trial import Trial, Units

    from ..evaluate import free_run  # loads the identification only if needed
    from ..identify.chain_fit import OperatorFitSettings, fit_chain
    from ..identify.chain_kinds import backlash_starts
    from ..motions import probe_commands

    facts = model.metadata
    commands = probe_commands(facts)
    theta = free_run(model, commands, 0.5 * (facts.trained_angle.lower + facts.trained_angle.upper))
    t = np.arange(commands.size, dtype=np.float64) * facts.dt_s
    trial = Trial(
        t,
        commands,
        theta,
        units=Units(facts.command_unit, facts.angle_unit, inverse=False),
        source="the model's own free run",
    )
    fit = fit_chain(backlash_starts([trial]), [trial], OperatorFitSettings(skip_first_flexure=True))
    method = f"backlash fitted to the free run of a model of kind {facts.kind}"
    return simulator_for(Chain(fit.chain.core), facts, method)
