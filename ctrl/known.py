"""What controllers know of a device: the model that they predict with, and what they invert."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from hystmpc.models.inverse.surrogate_backlash import surrogate_backlash
from hystmpc.models.load import load_model
from hystmpc.models.model import Inverse, InvertiblePredictor, LoadedModel, Predictor
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.prediction.actuated import ActuatedInverse, ActuatedPredictor
from hystmpc.models.prediction.build import predictor_and_inverse, predictor_for
from hystmpc.models.simulator import ChainModel, Simulator

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


def known_model(model: LoadedModel, inverse: Path | None, lag_s: float) -> Known:
    """Predictors and inverses of a model.

    Args:
        model: loaded with start "conditioned".
        inverse: file of what is inverted in the model's place; a backlash fitted to it where it needs one and has none.
        lag_s: first-order lag of the command that the model does not contain; 0 for none.

    Raises:
        ModelError: if the file of the inverse cannot be used.
        FitError: if no stand-in can be fitted.
    """
    companion = _companion(model) if inverse is None else _given_inverse(inverse, model.metadata.dt_s)
    predictive = predictor_and_inverse(model, companion)
    alone = predictor_and_inverse(ChainModel(companion)) if isinstance(companion, Simulator) else predictive
    return Known(_actuated(predictive, lag_s), _actuated(alone, lag_s))


def _given_inverse(file: Path, dt_s: float) -> Simulator | LoadedModel:
    """A simulator to invert, or an inverse map."""
    given = load_model(file)
    if not isinstance(given, ChainModel):
        return given
    simulator = _at_sample_time(given.simulator, dt_s)
    return ChainModel(simulator) if given.metadata.inverted else simulator


def _companion(model: LoadedModel) -> Simulator | None:
    """A backlash that stands in where the model has no inverse of its own."""
    return None if isinstance(predictor_for(model), InvertiblePredictor) else surrogate_backlash(model)


def _at_sample_time(simulator: Simulator, dt_s: float) -> Simulator:
    """The simulator at another sample time: delays get the store that they need at it."""
    chain = simulator.chain
    before, after = (
        tuple(Delay.at_rate(o.delay_s, dt_s) if isinstance(o, Delay) else o for o in side)
        for side in (chain.before, chain.after)
    )
    return replace(simulator, chain=replace(chain, before=before, after=after), dt_s=dt_s)


def _actuated(model: Pair, lag_s: float) -> Pair:
    """The model behind an actuator of known lag; the model itself where that is zero."""
    if lag_s == 0:
        return model
    predictor = ActuatedPredictor(model[0], lag_s)
    return predictor, ActuatedInverse(predictor, model[1])
