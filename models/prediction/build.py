"""From a model file's content to what a controller needs: a fast predictor and an inverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from hystmpc.trials.errors import ModelError

from ..connections import operators_of, rest_of
from ..contract.metadata import ModelMetadata
from ..inverse.drive import Drive, DrivenInverse, split
from ..inverse.one_step import (
    AccompaniedPredictor,
    CompanionInverse,
    MappedPredictor,
    TrainedInverse,
    check_inverse_map,
)
from ..inverse.steady import steady_inverse
from ..model import Inverse, InvertiblePredictor, LoadedModel, Predictor
from ..operators.operator import Operator
from ..simulator import ChainModel, Simulator, simulator_for
from .compiled import CompiledPredictor
from .connected import ParallelPredictor, SeriesPredictor

if TYPE_CHECKING:
    from ..contract.load import OnnxModel

# A step unrolled to more scalar operations than this takes numba minutes to compile; a chain of operators has tens.
_COMPILED_INSTRUCTIONS = 500


def predictor_for(model: LoadedModel) -> Predictor:
    """The fastest predictor that there is for a model.

    Compiled for operator chains and exported graphs of few elementwise operations, kernels of their own for models of
    kind `lstm`, `gru` and `play_kernel`, onnxruntime and CasADi's derivatives for anything else.

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
    """The predictor of an ONNX file; what it needs takes a moment to load, which operators need not wait for."""
    from ..contract.load import OnnxModel

    assert isinstance(model, OnnxModel)  # there are these two
    if model.metadata.connections:
        return _connected_predictor(model)
    if model.metadata.kind in ("lstm", "gru"):
        from .recurrent import recurrent_predictor

        return recurrent_predictor(model)
    if model.metadata.kind == "play_kernel":
        from ..play_kernel.predictor import PlayKernelPredictor

        return PlayKernelPredictor.of_model(model)
    function = model.casadi_function()
    if function.is_a("SXFunction") and function.n_instructions() <= _COMPILED_INSTRUCTIONS:
        return CompiledPredictor.of_function(function, model.metadata)
    from .onnx_ import OnnxPredictor

    return OnnxPredictor(model)


def _connected_predictor(model: OnnxModel) -> Predictor:
    """The predictor of a model with operators in series or in parallel: each part by its own fastest route."""
    facts, rest = model.metadata, predictor_for(rest_of(model))
    if facts.connections[0].way == "series":
        return SeriesPredictor(Drive(operators_of(facts).operators, facts), rest)
    return ParallelPredictor(CompiledPredictor.of_simulator(_operators_of(facts)), rest)


def _operators_of(facts: ModelMetadata) -> Simulator:
    return simulator_for(operators_of(facts), facts, "operators of a connection")


Pair = tuple[Predictor, Inverse]


@dataclass(frozen=True, eq=False)
class Known:
    """Predictors with inverses of the same memory.

    Attributes:
        predictive: of predictive controllers.
        feedforward: of controllers that only invert: the same for a model that has an inverse and for an inverse map,
            else the operator that stands in for it. Corrected by the network at every sample, as predictive controllers
            want it for their first guess, that inverse would go back and forth across the dead band.
    """

    predictive: Pair
    feedforward: Pair

    @classmethod
    def one(cls, predictor: Predictor, inverse: Inverse) -> Self:
        """One pair for all controllers."""
        return cls((predictor, inverse), (predictor, inverse))

    def behind(self, operators: Sequence[Operator], facts: ModelMetadata) -> Known:
        """The same behind a drive of operators in series; `facts` are those of the model."""
        drive = Drive(operators, facts)

        def driven(predictor: Predictor, inverse: Inverse) -> Pair:
            return SeriesPredictor(drive, predictor), DrivenInverse(inverse, predictor, drive)

        return Known(driven(*self.predictive), driven(*self.feedforward))


def known_pairs(model: LoadedModel, companion: Simulator | LoadedModel | None = None) -> Known:
    """Predictors and inverses of a model.

    A compiled model is inverted exactly, and lags and delays of a chain or of a drive over a preview (`DrivenInverse`).
    Any other gets a companion whose inverse is asked instead: the given simulator, the operators that are connected in
    parallel, or a backlash fitted to the model's own free run. A model given instead has to be an inverse map, which
    runs beside the model and is asked itself.

    Raises:
        FitError: if no companion is given and none can be fitted.
        ModelError: if the inverse map is a forward model, or of another unit or sample time.
    """
    connection = next(iter(model.metadata.connections), None)
    if connection is not None and connection.way == "series" and companion is None:
        return known_pairs(rest_of(model)).behind(operators_of(model.metadata).operators, model.metadata)
    predictor = predictor_for(model)
    low, high = _inverse_range(model.metadata)
    if isinstance(companion, LoadedModel):
        check_inverse_map(companion.metadata, model.metadata)
        mapped = MappedPredictor(predictor, companion)
        return Known.one(mapped, TrainedInverse(mapped, low, high))
    if isinstance(model, ChainModel) and companion is None:
        return Known.one(predictor, inverse_of_chain(model.simulator))
    if isinstance(predictor, InvertiblePredictor) and companion is None:
        return Known.one(predictor, steady_inverse(predictor, low, high))
    if companion is None and connection is not None:
        companion = _operators_of(model.metadata)
    if companion is None:
        from ..inverse.surrogate_backlash import surrogate_backlash  # an identification, with all that it needs

        companion = surrogate_backlash(model)
    beside = CompiledPredictor.of_simulator(companion)
    both = AccompaniedPredictor(predictor, beside)
    alone = known_pairs(ChainModel(companion, "conditioned")).feedforward
    return Known((both, CompanionInverse(both, steady_inverse(beside, low, high))), alone)


def predictor_and_inverse(model: LoadedModel, companion: Simulator | LoadedModel | None = None) -> Pair:
    """Predictor and inverse that share one memory, as predictive controllers take them; see `known_pairs`."""
    return known_pairs(model, companion).predictive


def inverse_of_chain(simulator: Simulator) -> Inverse:
    """Inverse of a simulator, with the memory of its `CompiledPredictor`."""
    front, middle, back = split(simulator.chain)
    inner = CompiledPredictor.of_simulator(replace(simulator, chain=middle))
    inverse = steady_inverse(inner, simulator.command_limits.lower, simulator.command_limits.upper)
    if not front and not back:
        return inverse
    drives = [Drive(side, simulator.metadata()) if side else None for side in (front, back)]
    return DrivenInverse(inverse, inner, *drives)


def _inverse_range(facts: ModelMetadata) -> tuple[float, float]:
    """Commands among which the inverse searches: what the device may be sent."""
    return facts.command_limits.lower, facts.command_limits.upper
