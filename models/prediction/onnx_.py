"""Predictions of any exported model: plans in one batch through onnxruntime, Jacobians through CasADi step by step."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Vec

from ..contract.load import OnnxModel
from ..model import ModelPredictor

_SPARSE_ENTRIES = 4  # of A in a row, up to which its product is cheaper than directions through the step


@final
class OnnxPredictor(ModelPredictor):
    """Predictor of a model file of any kind, for models without compiled kernels.

    A roll-out is H runs of the step graph on all plans at once. A linearisation carries the tangents of the state along
    the plan, one column a command,

        X_k+1 = A_k X_k + B_k e_k',  d theta_k / d plan = C_k X_k + D_k e_k'

    by CasADi's exact derivatives of the step: by the matrices where A is sparse (history buffers, plays), by forward
    directions for the columns that are alive by then where it is not (recurrent networks).

    Args:
        model: the model file; controllers start from its rule `conditioned`.
    """

    def __init__(self, model: OnnxModel) -> None:
        super().__init__(model.metadata)
        self._model = model
        self._function = model.casadi_function()
        self._sparse = _sparse_derivative(self._function)
        self._horizons: dict[int, Any] = {}

    @property
    def uses_matrices(self) -> bool:
        """Whether tangents are carried by the matrices A, B, C, D; else by directions through the step."""
        return self._sparse is not None

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        theta, following = self._model.advance(state[None], np.array([[u]]))
        return float(theta[0, 0]), following[0]

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        states = np.tile(state, (plans.shape[0], 1))
        theta = np.empty(plans.shape)
        for k in range(plans.shape[1]):
            angle, states = self._model.advance(states, plans[:, k : k + 1])
            theta[:, k] = angle[:, 0]
        return theta

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, jacobian = self._horizon(plan.size)(state, plan)
        return np.asarray(theta).ravel(), np.asarray(jacobian)

    def _horizon(self, length: int) -> Any:
        """CasADi function (state, plan) -> angles and their Jacobian by the plan, built at the first call."""
        if length not in self._horizons:
            state, plan = ca.MX.sym("x", self._function.numel_in(0)), ca.MX.sym("u", length)
            x, columns = state, ca.MX.zeros(state.numel(), length)
            angles, rows = [], []
            for k in range(length):
                theta, following = self._function(x, plan[k])
                row, columns = self._tangent(x, plan[k], theta, following, columns, k)
                angles.append(theta)
                rows.append(row)
                x = following
            results = [ca.vertcat(*angles), ca.densify(ca.vertcat(*rows))]
            self._horizons[length] = ca.Function("horizon", [state, plan], results)
        return self._horizons[length]

    def _tangent(self, x: Any, u: Any, theta: Any, following: Any, columns: Any, k: int) -> tuple[Any, Any]:
        """d theta / d plan (1, H) and the next columns (S, H); those after the k-th are still zero."""
        length = columns.size2()
        if self._sparse is not None:
            by_state, by_u, theta_by_state, theta_by_u = self._sparse(x, u)
            unit = ca.DM(1, length)
            unit[0, k] = 1.0
            row = ca.mtimes(theta_by_state, columns) + ca.mtimes(theta_by_u, unit)
            return row, ca.mtimes(by_state, columns) + ca.mtimes(by_u, unit)
        width = _width(k + 1, length)
        unit = ca.DM.zeros(1, width)
        unit[0, k] = 1.0
        row, moved = self._function.forward(width)(x, u, theta, following, columns[:, :width], unit)
        rest = length - width
        return ca.horzcat(row, ca.MX(1, rest)), ca.horzcat(moved, ca.MX.zeros(x.numel(), rest))


def _sparse_derivative(function: Any) -> Any | None:
    """Function (x, u) -> A, B, C, D where A is sparse: a history buffer that shifts, plays that keep their place."""
    if function.jac_sparsity(1, 0).nnz() > _SPARSE_ENTRIES * function.numel_in(0):
        return None
    x, u = ca.MX.sym("x", function.numel_in(0)), ca.MX.sym("u")
    theta, following = function(x, u)
    blocks = [ca.jacobian(output, by) for output in (following, theta) for by in (x, u)]
    return ca.Function("derivative", [x, u], blocks)


def _width(needed: int, most: int) -> int:
    """Columns that are carried: the next power of two, so that few derivative functions are built."""
    return min(1 << (needed - 1).bit_length(), most)
