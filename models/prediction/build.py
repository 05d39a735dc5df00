"""From a model file's content to what a controller needs: a fast predictor and an inverse."""

from __future__ import annotations

from dataclasses import replace

from hystmpc.trials.errors import ModelError

from ..contract.metadata import ModelMetadata
from ..inverse.drive import Drive, DrivenInverse, split, states_of, whole_delay
from ..inverse.one_step import (
    AccompaniedPredictor,
    CompanionInverse,
    CompiledInverse,
    MappedPredictor,
    TrainedInverse,
    check_inverse_map,
)
from ..model import Inverse, InvertiblePredictor, LoadedModel, Predictor
from ..simulator import ChainModel, Simulator
from .compiled import CompiledPredictor

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


def predictor_and_inverse(
    model: LoadedModel, companion: Simulator | LoadedModel | None = None
) -> tuple[Predictor, Inverse]:
    """Predictor and inverse that share one memory.

    A compiled model is inverted exactly, and a chain's lags and delays over a preview (`DrivenInverse`). Any other gets
    a companion whose inverse is asked instead: the given simulator, or a backlash fitted to the model's own free run. A
    model given instead has to be an inverse map, which runs beside the model and is asked itself.

    Raises:
        FitError: if no companion is given and none can be fitted.
        ModelError: if the inverse map is a forward model, or of another unit or sample time.
    """
    predictor = predictor_for(model)
    low, high = _inverse_range(model.metadata)
    if isinstance(companion, LoadedModel):
        check_inverse_map(companion.metadata, model.metadata)
        mapped = MappedPredictor(predictor, companion)
        return mapped, TrainedInverse(mapped, low, high)
    if isinstance(model, ChainModel) and companion is None:
        return predictor, inverse_of_chain(model.simulator)
    if isinstance(predictor, InvertiblePredictor) and companion is None:
        return predictor, CompiledInverse(predictor, low, high)
    if companion is None:
        from ..inverse.surrogate_backlash import surrogate_backlash  # an identification, with all that it needs

        companion = surrogate_backlash(model)
    beside = CompiledPredictor.of_simulator(companion)
    both = AccompaniedPredictor(predictor, beside)
    return both, CompanionInverse(both, CompiledInverse(beside, low, high))


def inverse_of_chain(simulator: Simulator) -> Inverse:
    """Inverse of a simulator, with the memory of its `CompiledPredictor`."""
    front, middle, back = split(simulator.chain)
    inner = CompiledPredictor.of_simulator(replace(simulator, chain=middle))
    inverse = CompiledInverse(inner, simulator.command_limits.lower, simulator.command_limits.upper)
    if not front and not back:
        return inverse
    drives = [Drive.of_operators(side, simulator) if side else None for side in (front, back)]
    sizes, delay = (states_of(front), states_of(back)), whole_delay((*front, *back), simulator.dt_s)
    return DrivenInverse(inverse, inner, drives[0], drives[1], sizes, delay_samples=delay)


def _inverse_range(facts: ModelMetadata) -> tuple[float, float]:
    """Commands among which the inverse searches: what the device may be sent."""
    return facts.command_limits.lower, facts.command_limits.upper
