"""Support-vector regression on a window of commands: its numbers, step in float64, and step graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.models.model import StepFunction
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

if TYPE_CHECKING:
    import onnx


@dataclass(frozen=True)
class SvrWeights:
    """Radial basis functions around M support windows of the last L commands.

        w = (commands - u_offset) / u_scale,  commands = [u_k-(L-1)d, ..., u_k-d, u_k]
        theta = theta_offset + theta_scale (bias + sum_i a_i exp(-gamma |w - s_i|^2))

    The state is [u_k-(L-1)d, ..., u_k-1], S = (L - 1) d commands in their own unit, the newest last.

    Attributes:
        supports: s (M, L), scaled.
        coefficients: a (M,), the difference of the two multipliers.
        bias: scaled.
        gamma: width of the kernel.
        u_offset, u_scale: [cmd]; the trained commands become -1 to 1.
        theta_offset, theta_scale: [deg].
        stride: d, samples between the commands of a window.

    Source: S1 (SVR with a radial kernel, after Zhang 2017; the features are not stated there, the window is that of
    its LSTM).

    Raises:
        ModelError: if sizes do not fit, a number is not finite, or gamma or a scale is not positive.
    """

    supports: Vec
    coefficients: Vec
    bias: float
    gamma: float
    u_offset: float
    u_scale: float
    theta_offset: float
    theta_scale: float
    stride: int = 1

    def __post_init__(self) -> None:
        for name in ("supports", "coefficients"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.supports.ndim != 2 or self.coefficients.shape != self.supports.shape[:1] or self.supports.shape[1] < 2:
            raise ModelError(
                f"SVR: got supports {self.supports.shape} and coefficients {self.coefficients.shape}, "
                "expected (M, L) and (M,) with L >= 2"
            )
        scalars = [self.bias, self.gamma, self.u_offset, self.u_scale, self.theta_offset, self.theta_scale]
        finite = all(np.isfinite(a).all() for a in (self.supports, self.coefficients, scalars))
        if not finite or min(self.gamma, self.u_scale, self.theta_scale) <= 0 or self.stride < 1:
            raise ModelError(f"SVR: got {scalars}, expected finite numbers, gamma, scales and stride > 0")

    @property
    def lags(self) -> int:
        """Number L of commands in a window, the present one included."""
        return self.supports.shape[1]

    @property
    def state_size(self) -> int:
        """Number S = (L - 1) d of state entries."""
        return (self.lags - 1) * self.stride


@final
class SvrStep(StepFunction):
    """Reference step of `weights`; equations in `SvrWeights`."""

    def __init__(self, weights: SvrWeights) -> None:
        self.weights = weights
        self.state_size = weights.state_size

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        w = self.weights
        commands = np.hstack([state, u])
        y = np.array([self._kernels(row[:: w.stride]) @ w.coefficients for row in commands])[:, None] + w.bias
        return w.theta_offset + w.theta_scale * y, commands[:, 1:]

    def jacobian(self, state: Vec, u: float) -> Vec:
        w = self.weights
        commands = np.append(state, u)[:: w.stride]
        weighted = w.coefficients * self._kernels(commands)
        gap = (commands - w.u_offset) / w.u_scale - w.supports
        slope = np.zeros(self.state_size + 1)
        slope[:: w.stride] = -2 * w.gamma * w.theta_scale / w.u_scale * (weighted @ gap)
        return np.vstack([slope, np.eye(self.state_size + 1)[1:]])

    def _kernels(self, commands: Vec) -> Vec:
        """Kernel values (M,) of one window (L,)."""
        w = self.weights
        gap = (commands - w.u_offset) / w.u_scale - w.supports
        return np.exp(-w.gamma * np.einsum("ml,ml->m", gap, gap))


def svr_step_graph(weights: SvrWeights) -> onnx.GraphProto:
    """Step graph (u [N,1], state [N,S]) -> (theta [N,1], next_state [N,S]).

    ONNX-ML's SVMRegressor, which skl2onnx writes, is single precision and has no derivative: here the same sum stands
    in matrix products, -gamma |w - s|^2 = 2 gamma w.s - gamma |s|^2 - gamma |w|^2.
    """
    from hystmpc.models.contract.onnx_nodes import graph_of_nodes, node

    gamma = weights.gamma
    numbers = {
        "u_offset": weights.u_offset,
        "u_scale": weights.u_scale,
        "supports": 2 * gamma * weights.supports.T,
        "support_norms": -gamma * np.sum(weights.supports**2, axis=1),
        "minus_gamma": -gamma,
        "coefficients": weights.coefficients[:, None],
        "bias": weights.bias,
        "theta_scale": weights.theta_scale,
        "theta_offset": weights.theta_offset,
    }
    size = weights.state_size
    indices = {"sizes": [1, size], "features": [1], "places": list(range(0, size + 1, weights.stride))}
    nodes = [
        node("Concat", "state u", "commands", axis=1),
        node("Split", "commands sizes", "oldest next_state", axis=1),
        node("Gather", "commands places", "window", axis=1),
        node("Sub", "window u_offset", "centred"),
        node("Div", "centred u_scale", "w"),
        node("Mul", "w w", "squares"),
        node("ReduceSum", "squares features", "square", keepdims=1),
        node("Mul", "square minus_gamma", "own_norm"),
        node("MatMul", "w supports", "products"),
        node("Add", "products support_norms", "shifted"),
        node("Add", "shifted own_norm", "exponents"),
        node("Exp", "exponents", "kernels"),
        node("MatMul", "kernels coefficients", "summed"),
        node("Add", "summed bias", "y"),
        node("Mul", "y theta_scale", "scaled"),
        node("Add", "scaled theta_offset", "theta"),
    ]
    return graph_of_nodes("svr", size, nodes, numbers, indices)
