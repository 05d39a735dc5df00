"""Settings of the controllers with an inverse: what they build their laws and estimators from."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import field_validator

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import Count, NotNegative

from .command import CommandLimits
from .estimation.observer import EstimatorSettings, Observer
from .feedback import REFERENCE_DEAD_ZONE_DEG, InverseFeedforward, InversePid, Pid, PidSettings, needs_sensor
from .law import Law, LawSettings


class FeedforwardSettings(LawSettings):
    """What both controllers with an inverse have.

    Attributes:
        reference_dead_zone_deg: change of the reference that is not followed [deg].
        preview: samples of the reference that the inverse of a model with lag or delay looks at.
        estimator: how state and disturbance are estimated from the measurements.
    """

    estimator: EstimatorSettings = EstimatorSettings()  # pyright: ignore[reportIncompatibleVariableOverride]  # frozen
    reference_dead_zone_deg: NotNegative = REFERENCE_DEAD_ZONE_DEG
    preview: Count = 20

    def bridged_samples(self, dt_s: float) -> int:
        return self.estimator.bridged_samples(self.ladder.max_missing_samples, dt_s)

    def observer(self, predictor: Predictor) -> Observer:
        return self.estimator.observer(predictor)

    def feedforward(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> InverseFeedforward:
        """The inverse: over the preview for a model that answers late (`steady_inverse` too), else sample by sample."""
        from hystmpc.models.inverse.drive import DrivenInverse  # numba and CasADi, which importing settings spares
        from hystmpc.models.inverse.one_step import inverted_after_a_hold

        ahead = None
        if isinstance(inverse, DrivenInverse) or inverted_after_a_hold(inverse):
            from .linearised.feasible_inverse import FeasibleInverse

            ahead = FeasibleInverse(predictor, inverse, limits, self.preview)
        return InverseFeedforward(inverse, self.reference_dead_zone_deg, ahead)


class InverseControllerSettings(FeedforwardSettings):
    """Inverse feedforward."""

    kind: Literal["inverse"] = "inverse"

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
        return self.feedforward(predictor, inverse, limits)


class InversePidControllerSettings(FeedforwardSettings):
    """Inverse feedforward with PID feedback.

    Attributes:
        gains: of the PID.
    """

    kind: Literal["inverse_pid"] = "inverse_pid"
    gains: PidSettings = PidSettings(kp_per_deg=0.01, ki_per_deg_s=0.2)

    _measures = field_validator("estimator")(needs_sensor)

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
        feedforward = self.feedforward(predictor, inverse, limits)
        pid, oldest = Pid(self.gains, limits, predictor.dt), self.estimator.oldest_samples(predictor.dt)
        return InversePid(feedforward, pid, predictor, limits, oldest)
