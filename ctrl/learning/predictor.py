"""Model with a learned part: predictor, inverse and follower, as fronts of the engine; see core/model.h."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np

from hystmpc.core.structs import Struct, struct
from hystmpc.models.fronts import EnginePredictor, Front
from hystmpc.models.inverse.inverses import Follower
from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.trials.types import Vec

from ..command import attempt
from ..mpc_settings import AdaptationSettings
from .bank import LEARNED_SIZE, OF_WEIGHTS, FilterBank
from .likely import likely_changes

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
        return FilterBank(self.dt, self.command_range, scale, sensor, delay, self._settings, self._likely)

    @cached_property
    def _likely(self) -> Vec:
        return likely_changes(self.model, self.slope * self._span)

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
