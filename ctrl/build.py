"""Construction of controllers from settings: model with learned part, observer, law, fallbacks and limits."""

from __future__ import annotations

from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.prediction.build import ControllerModel

from .command import CommandLimits, narrowed_limits
from .config import AnyControllerSettings
from .guarded import GuardedController
from .law import LawPart, LawSettings
from .learning.predictor import LearnedInverse, LearnedPredictor
from .linearised.program import IterativeSolution
from .linearised.qp import OsqpOptions
from .mpc_settings import LinearisedMpcSettings, PredictiveSettings
from .problem import is_first_guess, problem_of


def build_controller(
    settings: AnyControllerSettings | LawSettings, predictor: Predictor, inverse: Inverse, limits: CommandLimits
) -> GuardedController:
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
    known = predictor.model if isinstance(predictor, LearnedPredictor) else predictor
    observer_of = getattr(settings, "observer", settings.estimator.observer)
    observer, law = observer_of(known), None
    if theirs := getattr(settings, "law", None):
        states = known.part.fields["states"] if observer.has_model else 0
        law = LawPart(theirs(predictor, inverse, limits), int(states))
    solve = _solution(settings, inverse, limits, predictor.dt)
    problem = problem_of(settings, predictor, inverse, limits, observer=observer, law=law, solve=solve)
    rest = known.initial if observer.has_model else None
    inputs = dict(known.input_states) if observer.has_model else {}
    return GuardedController(problem, limits, observer, rest, law, solve, inputs)


def _solution(settings: LawSettings, inverse: Inverse, limits: CommandLimits, dt: float) -> IterativeSolution | None:
    """Solution of quadratic programs by OSQP, where the settings ask for it."""
    if not isinstance(settings, LinearisedMpcSettings) or settings.solver == "active_set":
        return None
    options, horizon = OsqpOptions(eps=settings.solver_eps), settings.preview_samples(dt)
    weights = settings.weights.discounted(is_first_guess(inverse))
    return IterativeSolution(weights, limits, horizon, dt, settings.blocks(dt), options)


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
