"""The reference route: roll-out and linearisation of any model's CasADi function, exact and slow."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..model import Predictor


@final
class CasadiPredictor(Predictor):
    """Predictor of any CasADi function (state, u) -> (theta, next state), by CasADi's own derivatives.

    Roll-outs and Jacobians of one horizon length are built at the first call for that length.
    """

    def __init__(self, function: Any, metadata: ModelMetadata) -> None:
        self.dt = metadata.dt_s
        self.command_range = (metadata.trained_command.lower, metadata.trained_command.upper)
        self._function, self._metadata = function, metadata
        self._size = function.numel_in(0)
        self._horizons: dict[int, Any] = {}

    def initial(self, y: float, u: float) -> Vec:
        state = self._metadata.conditioned.state(np.array([[y]]))[0]
        for _ in range(self._metadata.warmup_samples):
            _, state = self.advance(state, u)
        return state

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        theta, following = self._function(state, u)
        return float(theta), np.asarray(following).ravel()

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return np.array([np.asarray(self._horizon(plans.shape[1])(state, plan)[0]).ravel() for plan in plans])

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, jacobian = self._horizon(plan.size)(state, plan)
        return np.asarray(theta).ravel(), np.asarray(jacobian)

    def _horizon(self, length: int) -> Any:
        """CasADi function (state, plan) -> angles and their Jacobian by the plan."""
        if length not in self._horizons:
            state, plan = ca.MX.sym("x", self._size), ca.MX.sym("u", length)
            x, angles = state, []
            for k in range(length):
                theta, x = self._function(x, plan[k])
                angles.append(theta)
            theta = ca.vertcat(*angles)
            self._horizons[length] = ca.Function(
                "horizon", [state, plan], [theta, ca.densify(ca.jacobian(theta, plan))]
            )
        return self._horizons[length]
