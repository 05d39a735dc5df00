"""A model behind an actuator whose lag is known: what was identified on recorded travel, driven by a commanded one."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..model import Predictor


@final
class LagPredictor(Predictor):
    """Travel behind a first-order lag of the command, exact for commands constant over a sample.

    v_k = v_{k-1} + a (u_k - v_{k-1}),  a = 1 - exp(-dt / tau)

    so that d v / d u = L with L_ij = a (1 - a)^{i-j} for i >= j. The state is [v]; what it predicts are travels.

    Args:
        predictor: of the model behind the lag, for sample time and range.
        lag_s: time constant tau [s].

    Raises:
        ModelError: if the time constant is not a positive number.
    """

    def __init__(self, predictor: Predictor, lag_s: float) -> None:
        if not (math.isfinite(lag_s) and lag_s > 0):
            raise ModelError(f"actuator lag: got {lag_s} s, expected a positive time constant")
        self.dt, self.command_range, self.noise = predictor.dt, predictor.command_range, predictor.noise
        self.gain = 1 - math.exp(-predictor.dt / lag_s)
        self._kept = np.empty((0, 0))

    def initial(self, y: float, u: float) -> Vec:
        del y
        return np.array([u])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        v = state + self.gain * (u - state)
        return float(v[0]), v

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        samples = np.arange(1, plans.shape[-1] + 1)
        return plans @ self.response(plans.shape[-1]).T + state[0] * (1 - self.gain) ** samples

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        return self.rollout(state, plan), self.response(plan.size)

    def response(self, horizon: int) -> Vec:
        """L (H, H): travel at sample i for a unit command at sample j; computed once for a horizon."""
        kept = self._kept
        if kept.shape[0] != horizon:
            age = np.subtract.outer(np.arange(horizon), np.arange(horizon))
            self._kept = kept = np.where(age >= 0, self.gain * (1 - self.gain) ** np.maximum(age, 0), 0.0)
        return kept


@final
class ActuatedPredictor(Predictor):
    """Predictor of a model whose command first passes a first-order lag: theta = model(v), v as in `LagPredictor`.

    d theta / d u = (d theta / d v) L. The state is [model state, v].

    Args:
        predictor: the model that answers to the actuator's true travel v.
        lag_s: time constant tau of the actuator [s].

    Raises:
        ModelError: if the time constant is not a positive number.
    """

    def __init__(self, predictor: Predictor, lag_s: float) -> None:
        self.lag = LagPredictor(predictor, lag_s)
        self.dt, self.command_range, self.noise = predictor.dt, predictor.command_range, predictor.noise
        self._predictor = predictor

    def initial(self, y: float, u: float) -> Vec:
        return np.append(self._predictor.initial(y, u), u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        v, after = self.lag.advance(state[-1:], u)
        theta, following = self._predictor.advance(state[:-1], v)
        return theta, np.append(following, after)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._predictor.rollout(state[:-1], self.lag.rollout(state[-1:], plans))

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        travel, by_command = self.lag.linearise(state[-1:], plan)
        theta, by_travel = self._predictor.linearise(state[:-1], travel)
        return theta, by_travel @ by_command
