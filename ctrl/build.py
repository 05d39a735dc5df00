"""Construction of controllers from settings: model with learned part, estimator, law, fallbacks and limits."""

from __future__ import annotations

from typing import Any

from hystmpc.models.inverse.drive import DrivenInverse
from hystmpc.models.inverse.inverses import inverted_after_a_hold
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.prediction.build import ControllerModel
from hystmpc.trials.errors import ControllerError

from .command import CommandLimits, narrowed_limits
from .config import AnyControllerSettings
from .estimation.observer import EstimatorSettings, LastMeasurement, Observer
from .feedback import (
    FeedforwardSettings,
    InverseFeedforward,
    InversePid,
    InversePidControllerSettings,
    Pid,
    PidControllerSettings,
    PidFeedback,
    supervisory_law,
)
from .guarded import FallbackChain, GuardedController, Law, LawSettings
from .learning.predictor import LearnedInverse, LearnedPredictor, LearningEstimator
from .linearised.planner import FeasibleInverse, LinearisedPlanner
from .mpc import Planner, PredictiveLaw
from .mpc_settings import LinearisedMpcSettings, PredictiveSettings, SamplingMpcSettings
from .sampling import CrossEntropyPlanner, PathIntegralPlanner

_REFINED = 2  # iterations from a plan that is late along a motion


def build_controller(
    settings: AnyControllerSettings | LawSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> GuardedController[Any]:
    """Build the controller that `settings` describe.

    Args:
        settings: one of the classes of `CONTROLLERS`, or a class of yours derived from `LawSettings`.
        limits: hard limits of the device; `settings.limits` may narrow them.

    Raises:
        ControllerError: if the settings contradict each other or go beyond the device's limits.
    """
    settings = settings.resolved()
    limits = narrowed_limits(limits, settings.limits)
    predictor, inverse = learning_pair(settings, predictor, inverse)
    fallback = FallbackChain(limits, settings.ladder, inverse if settings.falls_back_on_inverse else None)
    law, observer = law_of(settings, predictor, inverse, limits), observer_of(settings, predictor)
    return GuardedController(law, observer, fallback, limits, predictor.dt, settings.bridged_samples(predictor.dt))


def pair_for(settings: AnyControllerSettings | LawSettings, model: ControllerModel) -> tuple[Predictor, Inverse]:
    """Return predictor and inverse of a controller, with a learned part where its settings ask for one."""
    settings = settings.resolved()
    return learning_pair(settings, *(model.predictive if settings.predicts else model.feedforward))


def learning_pair(settings: LawSettings, predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
    """Add the learned part that the settings ask for to predictor and inverse."""
    if theirs := getattr(settings, "model_pair", None):
        return theirs(predictor, inverse)
    if not isinstance(settings, PredictiveSettings) or settings.adaptation is None:
        return predictor, inverse
    if isinstance(predictor, LearnedPredictor):
        return predictor, inverse
    learned = LearnedPredictor(predictor, settings.adaptation)
    return learned, LearnedInverse(learned, inverse)


def observer_of(settings: LawSettings, predictor: Predictor) -> Observer:
    """Build the estimator of state and disturbance."""
    if theirs := getattr(settings, "observer", None):
        return theirs(predictor)
    estimator = settings.estimator
    if not isinstance(estimator, EstimatorSettings):  # of PID, which has no model
        return LastMeasurement(None if estimator.sensor == "continuous" else estimator.oldest_samples(predictor.dt))
    if isinstance(settings, PredictiveSettings) and isinstance(predictor, LearnedPredictor):
        return LearningEstimator(predictor, estimator)
    return estimator.observer(predictor)


def law_of(settings: LawSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
    """Build the control law.

    Raises:
        ControllerError: if there is none for settings of this class.
    """
    if theirs := getattr(settings, "law", None):
        return theirs(predictor, inverse, limits)
    if isinstance(settings, PredictiveSettings):
        law = PredictiveLaw(predictor, inverse, limits, _planner(settings, predictor, inverse, limits), settings)
        if settings.supervisor is None:
            return law
        return supervisory_law(law, settings.supervisor, (predictor, inverse), limits)
    if isinstance(settings, PidControllerSettings):
        return PidFeedback(Pid(settings.gains, limits, predictor.dt), limits)
    if not isinstance(settings, FeedforwardSettings):
        raise ControllerError(f"controller: got {type(settings).__name__}, expected a class with a method `law`")
    feedforward = _feedforward(settings, predictor, inverse, limits)
    if not isinstance(settings, InversePidControllerSettings):
        return feedforward
    pid = Pid(settings.gains, limits, predictor.dt)
    return InversePid(feedforward, pid, predictor, limits, settings.estimator.oldest_samples(predictor.dt))


def _planner(
    settings: PredictiveSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> Planner[Any]:
    settings = settings.model_copy(update={"iterations": iterations_of(settings, inverse)})
    if isinstance(settings, LinearisedMpcSettings):
        return LinearisedPlanner(predictor, settings, limits)
    assert isinstance(settings, SamplingMpcSettings)
    kind = CrossEntropyPlanner if settings.method == "cem" else PathIntegralPlanner
    return kind(predictor, settings, limits)


def iterations_of(settings: PredictiveSettings, inverse: Inverse) -> int:
    """Return the planner's iterations per step: at least two for a first-guess inverse, see `steady_inverse`."""
    first_guess = inverted_after_a_hold(inverse.inverse if isinstance(inverse, LearnedInverse) else inverse)
    return max(settings.iterations, _REFINED) if first_guess else settings.iterations


def _feedforward(
    settings: FeedforwardSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> InverseFeedforward:
    """Build the inverse feedforward: over the preview for a model with delay or `steady_inverse`, else per sample."""
    late = isinstance(inverse, DrivenInverse) or inverted_after_a_hold(inverse)
    ahead = FeasibleInverse(predictor, inverse, limits, settings.preview) if late else None
    return InverseFeedforward(inverse, settings.reference_dead_zone_deg, ahead)
