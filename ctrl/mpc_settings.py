"""The predictive controllers: their settings, and how the law, the observer and the planner are built from them."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, Self

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import Count

from .command import CommandLimits
from .estimation.observer import Observer
from .law import Law
from .planning_settings import LinearisationSettings, PredictiveSettings, SamplingSettings

if TYPE_CHECKING:
    from .mpc import Planner

_REFINED = 2  # iterations from a plan that is late along a motion

# numba, SciPy and the solvers take over a second to import: a controller is built by functions that import them.


class PredictiveController(PredictiveSettings):
    """Builds the law and the observer; the planner is that of the subclass."""

    iterations: Count = 1

    def model_pair(self, predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
        if self.adaptation is None:
            return predictor, inverse
        from .learning.predictor import LearnedInverse, LearnedPredictor

        if isinstance(predictor, LearnedPredictor):
            return predictor, inverse
        learned = LearnedPredictor(predictor, self.adaptation)
        return learned, LearnedInverse(learned, inverse)

    def observer(self, predictor: Predictor) -> Observer:
        from .learning.predictor import LearnedPredictor, LearningEstimator

        if isinstance(predictor, LearnedPredictor):
            return LearningEstimator(predictor, self.estimator)
        return self.estimator.observer(predictor)

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
        from .mpc import PredictiveLaw

        planner = self.refining(inverse).planner(predictor, limits)
        law = PredictiveLaw(predictor, inverse, limits, planner, self)
        if self.supervisor is None:
            return law
        from .supervisor import supervisory_law

        return supervisory_law(law, self.supervisor, (predictor, inverse), limits)

    def refining(self, inverse: Inverse) -> Self:
        """These settings, with two iterations or more where the inverse is a first guess only; see `steady_inverse`."""
        from hystmpc.models.inverse.one_step import inverted_after_a_hold

        from .learning.predictor import LearnedInverse

        inner = inverse.inverse if isinstance(inverse, LearnedInverse) else inverse
        if not inverted_after_a_hold(inner):
            return self
        return self.model_copy(update={"iterations": max(self.iterations, _REFINED)})

    @abstractmethod
    def planner(self, predictor: Predictor, limits: CommandLimits) -> Planner[Any]:
        """What improves the best candidate plan."""


class LinearisedMpcSettings(PredictiveController, LinearisationSettings):
    """Real-time iteration; see `LinearisedPlanner`.

    Attributes:
        iterations: linearisations per step.
        solver: of the quadratic programs.
        solver_eps: tolerance of OSQP; DAQP is exact.
        move_blocking: samples of each block of moves, see `MoveBlocking`; null lets every sample move, but for a
            preview of more than 20 samples whose length is not given, see `LinearisationSettings.blocks`.
    """

    def planner(self, predictor: Predictor, limits: CommandLimits) -> Planner[Any]:
        from .linearised.planner import LinearisedPlanner

        return LinearisedPlanner(predictor, self, limits)


class SamplingMpcSettings(PredictiveController, SamplingSettings):
    """Model-predictive path integral control (MPPI) or the cross-entropy method (CEM).

    Attributes:
        method: which of them.
        samples: plans per iteration N; at least twice as many as there are blocks show every direction twice.
        iterations: times the distribution is moved per step.
        sigma: largest standard deviation of the perturbations [mm or bar]; null for a tenth of the greatest move that
            the rate limit allows in a sample.
        finest: smallest one as a share of `sigma`.
        temperature: of MPPI's weights exp(-(J - J_min) / lambda), with lambda = temperature (median J - J_min).
        elites: share of the samples that mean and deviation of CEM are fitted to, at least two plans.
        seed: of the random numbers.
        noise: shape of the perturbations, at the ends of the blocks of a preview of more than 20 samples; see
            `SamplingSettings.blocks`.
    """

    def planner(self, predictor: Predictor, limits: CommandLimits) -> Planner[Any]:
        from .sampling import CrossEntropyPlanner, PathIntegralPlanner

        kind = CrossEntropyPlanner if self.method == "cem" else PathIntegralPlanner
        return kind(predictor, self, limits)
