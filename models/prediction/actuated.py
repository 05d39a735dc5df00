"""A model behind an actuator whose lag is known: what was identified on recorded travel, driven by a commanded one."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..model import Inverse, Predictor


@final
class ActuatedPredictor(Predictor):
    """Predictor of a model whose command first passes a first-order lag, exact for commands constant over a sample.

    v_k = v_{k-1} + a (u_k - v_{k-1}),  a = 1 - exp(-dt / tau),  theta = model(v)

    so that d theta / d u = (d theta / d v) L, with L_ij = a (1 - a)^{i-j} for i >= j. The state is [model state, v].

    Args:
        predictor: the model that answers to the actuator's true travel v.
        lag_s: time constant tau of the actuator [s].

    Raises:
        ModelError: if the time constant is not a positive number.
    """

    def __init__(self, predictor: Predictor, lag_s: float) -> None:
        if not (math.isfinite(lag_s) and lag_s > 0):
            raise ModelError(f"actuator lag: got {lag_s} s, expected a positive time constant")
        self.dt, self.command_range, self.noise = predictor.dt, predictor.command_range, predictor.noise
        self.gain = 1 - math.exp(-predictor.dt / lag_s)
        self._predictor = predictor
        self._kept = np.empty((0, 0))

    def initial(self, y: float, u: float) -> Vec:
        return np.append(self._predictor.initial(y, u), u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        v = state[-1] + self.gain * (u - state[-1])
        theta, following = self._predictor.advance(state[:-1], float(v))
        return theta, np.append(following, v)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._predictor.rollout(state[:-1], self._travel(state, plans))

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, by_travel = self._predictor.linearise(state[:-1], self._travel(state, plan))
        return theta, by_travel @ self._response(plan.size)

    def _travel(self, state: Vec, plans: Vec) -> Vec:
        """True travel (..., H) under the plans (..., H)."""
        samples = np.arange(1, plans.shape[-1] + 1)
        return plans @ self._response(plans.shape[-1]).T + state[-1] * (1 - self.gain) ** samples

    def _response(self, horizon: int) -> Vec:
        """L (H, H): travel at sample i for a unit command at sample j; computed once for a horizon."""
        kept = self._kept
        if kept.shape[0] != horizon:
            age = np.subtract.outer(np.arange(horizon), np.arange(horizon))
            self._kept = kept = np.where(age >= 0, self.gain * (1 - self.gain) ** np.maximum(age, 0), 0.0)
        return kept


@final
class ActuatedInverse(Inverse):
    """Inverse of an actuated model: the travel that the model needs, then the command that brings the actuator there.

    u = v_{k-1} + (v - v_{k-1}) / a,  v = inverse(theta); see `ActuatedPredictor`.
    """

    def __init__(self, predictor: ActuatedPredictor, inverse: Inverse) -> None:
        self.gain, self.inverse = predictor.gain, inverse

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        del u_last  # in a dead band the travel stays where it is
        v = float(state[-1])
        return v + (self.inverse.command(state[:-1], theta, v) - v) / self.gain
