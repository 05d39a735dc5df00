"""Model with a learned part: predictor, inverse, follower, and the estimator that learns it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from hystmpc.core.structs import Struct, struct
from hystmpc.models.fronts import EnginePredictor, Front
from hystmpc.models.inverse.inverses import Follower
from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.trials.types import Vec

from ..command import attempt, replace
from ..estimation.observer import Estimate, EstimatorSettings, Observer, OutputEstimator, usable_angle
from ..mpc_settings import AdaptationSettings
from .bank import LEARNED_SIZE, OF_WEIGHTS, BankState, FilterBank

_RANGE_DEG = 60.0  # angle over the command range, if the model does not state it [deg]
_SENSOR_DEG = 0.1  # standard deviation of the sensor, if the model's file does not state it [deg]


@final
class LearnedPredictor(EnginePredictor):
    """Model with a learned part: theta = m + w_c (m - m_0) + sum_i w_i f_i, see `bank`; constant weights.

    The state is the model's, then the learned part's (LEARNED_SIZE,).
    """

    def __init__(self, model: Predictor, settings: AdaptationSettings) -> None:
        self._as(model)
        self.model = model
        low, high = model.command_range
        self.slope = attempt(lambda: static_gain(model))[0] or _RANGE_DEG / (high - low)  # a model may fail
        self._settings, self._span = settings, high - low
        self._bank = self.filters(0)

    @property
    def state_size(self) -> int:
        return self.model.state_size + LEARNED_SIZE

    @property
    def whole(self) -> Struct:
        return self.behind(None)

    def behind(self, inverse: Inverse | None) -> Struct:
        """`hystmpc_model` of model and learned part, with an inverse of the model alone."""
        inverted = None if inverse is None else inverse.part
        return struct("hystmpc_model", predictor=self.model.part, inverse=inverted, learner=self._bank.struct())

    def filters(self, delay: int) -> FilterBank:
        """Build the bank that learns the weights, behind `delay` samples of delay that the model does not have."""
        sensor = _SENSOR_DEG if self.noise is None else self.noise.sensor_sigma_deg
        scale = self.slope * self._span
        return FilterBank(self.dt, self.command_range, scale, sensor, delay, self._settings)

    def initial(self, y: float, u: float) -> Vec:
        _, part = self._bank.acting(self._bank.init(y, u, y), (y,))
        return np.concatenate([self.model.initial(y, u), part])

    def learned(self, state: Vec, plans: Vec) -> Vec:
        """Learned part (N, H) of the angles [deg] along the plans (N, H)."""
        return self.rollout(state, plans) - self.model.rollout(self.below(state), plans)

    def below(self, state: Vec) -> Vec:
        """State of the model without the learned part."""
        return state[: state.size - LEARNED_SIZE]

    def weights(self, state: Vec) -> Vec:
        """Weights w_c [1] and w [deg] of the learned part, shape (1 + FEATURES,)."""
        return state[state.size - LEARNED_SIZE :][OF_WEIGHTS]


@final
class LearnedInverse(Inverse):
    """Model inverse at the angle minus the learned part in a hold; see `LearnedFollower` for plans."""

    def __init__(self, predictor: LearnedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    @cached_property
    def _front(self) -> Front:
        return Front(self.predictor.behind(self.inverse))

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        return self._front.command(state, theta, u_last)


@final
class LearnedFollower(Follower):
    """Fixed-point inverse along a preview: the model's inverse follows the angles minus the learned part."""

    def __init__(self, inverse: LearnedInverse) -> None:
        super().__init__(inverse.predictor.behind(inverse.inverse))


@dataclass(frozen=True, eq=False)
class Learning:
    """Memory of a `LearningEstimator`.

    Attributes:
        added: learned part of each of the model's angles [deg].
    """

    model: Estimate
    bank: BankState
    added: tuple[float, ...]


@final
class LearningEstimator(Observer):
    """Estimator of a model with a learned part: y_k = m_k + s w' f_k + d_k + v_k.

    Weights w and share s are those of a `FilterBank`; d is that of a `NoiseBank` on the remaining error. Changes of
    weights or share are compensated by d, so that the present angle does not jump.

    An angle far from the prediction is accepted if the device can have moved there since the last one.
    """

    def __init__(self, predictor: LearnedPredictor, settings: EstimatorSettings) -> None:
        self._predictor, self._settings = predictor, settings
        self._plain = OutputEstimator(predictor.model, settings)
        self.delay_samples = settings.delay_samples
        self._bank = predictor.filters(settings.delay_samples)

    def init(self, y: float, u: float) -> Estimate:
        model = self._plain.init(y, u)
        bank = self._bank.init(model.angles[0], u, y)
        return self._whole(model, bank, self._acting(bank, model), model.bank, model.disturbance, model.variance)

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        return self._plain.sigma_ahead_deg(estimate, travels)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        learning, angle, far = _learning(estimate), usable_angle(y), self._settings.outlier_deg
        offset = angle - estimate.angles[0]
        reach = far + self._bank.reach(learning.bank)
        if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= reach):
            return replace(estimate, missing=estimate.missing + 1)
        model = learning.model
        bank = self._bank.correct(learning.bank, angle, model.angles[0], model.disturbance)
        model = replace(self._plain.correct(model, angle), command=estimate.command, measured=angle, missing=0)
        acting = self._acting(bank, model)
        change = acting[0][0] - learning.added[0]
        noise = estimate.bank.copy()
        noise[0] -= change
        if not model.responsive[0]:  # inside the dead band, where one is set
            return self._whole(model, bank, acting, noise, estimate.disturbance - change, estimate.variance)
        noise, disturbance, variance = self._plain.bank.correct(noise, offset - change)
        return self._whole(model, bank, acting, noise, disturbance, variance)

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._plain.advance(_model(estimate), u), u)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._plain.coast(_model(estimate), u), u)

    def _later(self, before: Estimate, model: Estimate, u: float) -> Estimate:
        bank = self._bank.advance(_learning(before).bank, u)
        noise, variance = self._plain.bank.advance(before.bank, model.moves[0], before.disturbance)
        acting = self._acting(bank, model)
        after = self._whole(model, bank, acting, noise, before.disturbance, variance)
        return replace(after, missing=before.missing) if before.missing else after

    def _acting(self, bank: BankState, model: Estimate) -> tuple[list[float], Vec]:
        """Learned part of each of the model's angles [deg], and that of the state."""
        added, part = self._bank.acting(bank, model.angles)
        return added.tolist(), part

    def _whole(
        self,
        model: Estimate,
        bank: BankState,
        acting: tuple[list[float], Vec],
        noise: Vec,
        disturbance: float,
        variance: float,
    ) -> Estimate:
        added, part = acting
        return replace(
            model,
            state=np.concatenate([model.state, part]),
            angles=tuple(angle + more for angle, more in zip(model.angles, added, strict=True)),
            disturbance=disturbance,
            variance=variance,
            bank=noise,
            added=added[0],
            learning=Learning(model, bank, tuple(added)),
            forecast_error=bank.forecast_error,
        )


def _model(estimate: Estimate) -> Estimate:
    """Estimate of the model alone, with the command that the device really holds."""
    model = _learning(estimate).model
    return model if model.command == estimate.command else replace(model, command=estimate.command)


def _learning(estimate: Estimate) -> Learning:
    assert isinstance(estimate.learning, Learning)
    return estimate.learning
