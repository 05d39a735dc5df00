"""From a model file's content to what a controller needs: a fast predictor and an inverse."""

from __future__ import annotations

from hystmpc.trials.errors import ModelError

from ..chain_model import ChainModel
from ..contract.metadata import ModelMetadata
from ..inverse.companion import AccompaniedPredictor, CompanionInverse
from ..inverse.one_step import CompiledInverse
from ..inverse.shadow import shadow_simulator
from ..load import AnyModel
from ..model import Inverse, Predictor
from ..simulator import Simulator
from .casadi_ import CasadiPredictor
from .compiled import CompiledPredictor


def predictor_for(model: AnyModel) -> Predictor:
    """The fastest predictor that there is for a model.

    Compiled for operator chains and exported graphs of elementwise operations, the LSTM kernels for networks of kind
    `lstm`, CasADi's own evaluation for anything else.

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
    if model.metadata.kind == "lstm":
        from .lstm import LstmPredictor  # its kernels take a moment to load, which operators need not wait for

        return LstmPredictor.of_model(model)
    function = model.casadi_function()
    if function.is_a("SXFunction"):
        return CompiledPredictor.of_function(function, model.metadata)
    return CasadiPredictor(function, model.metadata)


def predictor_and_inverse(model: AnyModel, companion: Simulator | None = None) -> tuple[Predictor, Inverse]:
    """Predictor and inverse that share one memory.

    A compiled model is inverted exactly. Any other gets a companion whose inverse is asked instead: the given
    simulator, or a backlash fitted to the model's own free run.

    Raises:
        FitError: if no companion is given and none can be fitted.
    """
    predictor = predictor_for(model)
    low, high = _inverse_range(model.metadata)
    if isinstance(predictor, CompiledPredictor) and companion is None:
        return predictor, CompiledInverse(predictor, low, high)
    beside = CompiledPredictor.of_simulator(companion or shadow_simulator(model))
    both = AccompaniedPredictor(predictor, beside)
    return both, CompanionInverse(both, CompiledInverse(beside, low, high))


def _inverse_range(facts: ModelMetadata) -> tuple[float, float]:
    """Commands among which the inverse searches: what the device may be sent."""
    return facts.command_limits.lower, facts.command_limits.upper
