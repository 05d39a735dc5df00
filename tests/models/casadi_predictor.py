"""The reference route: roll-out and linearisation of any model's CasADi function, exact and slow."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.model import ModelPredictor
from hystmpc.trials.types import Vec


@final
class CasadiPredictor(ModelPredictor):
    """Predictor of any CasADi function (state, u) -> (theta, next state), by CasADi's own derivatives.

    Roll-outs and Jacobians of one horizon length are built at the first call for that length.
    """

    def __init__(self, function: Any, metadata: ModelMetadata) -> None:
        super().__init__(metadata)
        self._function = function
        self._size = function.numel_in(0)
        self._horizons: dict[int, Any] = {}

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
