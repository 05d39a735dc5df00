"""A simulator as a stateful model, run by its compiled step."""

from __future__ import annotations

from typing import Literal, final

import casadi as ca
import numpy as np

from .contract.metadata import ModelMetadata
from .kernels.chain_kernels import compile_step
from .model import Array, StepFunction
from .simulator import Simulator
from .symbolic.instructions import dense


@final
class ChainModel(StepFunction):
    """Operator chain as model: `Model` for free runs, `StepFunction` as the reference of its own export.

    The model state is x = [chain state, angle], so that the output is a projection (nx = S + 1).
    """

    def __init__(self, simulator: Simulator, start: Literal["initial", "conditioned"] = "initial") -> None:
        self.simulator = simulator
        self.metadata: ModelMetadata = simulator.metadata()
        self.nx: int = simulator.chain.state_size + 1
        self.nu: int = 1
        self.dt: float = simulator.dt_s
        self.state_size: int = simulator.chain.state_size
        self._rule = getattr(self.metadata, start)
        self._kernels = compile_step(simulator.chain.transition)
        self._p, self._dt = simulator.chain.values, np.array([simulator.dt_s])
        self._derivative = _step_jacobian(simulator)

    def initial(self, y: Array) -> Array:
        """States (N, S + 1) of devices that rest at angles y (N, 1) [deg]."""
        y = np.asarray(y, dtype=np.float64).reshape(-1, 1)
        return np.hstack([self._rule.state(y), y])

    def step(self, x: Array, u: Array) -> Array:
        """States (N, S + 1) one sample later under commands u (N, 1)."""
        theta, following = self.advance(np.asarray(x)[:, :-1], u)
        return np.hstack([following, theta])

    def output(self, x: Array) -> Array:
        """Angles (N, 1) [deg]."""
        return np.asarray(x)[:, -1:]

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Angles (N, 1) and next states (N, S) from states (N, S) and commands (N, 1)."""
        following = np.array(state, dtype=np.float64, order="C")
        u = np.ascontiguousarray(u, dtype=np.float64)
        theta = np.empty_like(u)
        self._kernels.simulate(following, u, self._p, self._dt, self._kernels.step_constants, theta)
        return theta, following

    def run(self, commands: Array, y: float) -> Array:
        """Free run (T,) [deg] over commands (T,) from the start rule and its warm-up."""
        full = np.concatenate([np.full(self.metadata.warmup_samples, commands[0]), commands])[None]
        theta = np.empty_like(full)
        state = self._rule.state(np.array([[y]]))
        self._kernels.simulate(state, full, self._p, self._dt, self._kernels.step_constants, theta)
        return theta[0, self.metadata.warmup_samples :]

    def casadi_function(self) -> ca.Function:
        """The step as `casadi.Function`: state (S, 1), u (1, 1) -> theta (1, 1), next_state (S, 1)."""
        function = self.simulator.chain.bound(self.dt)
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u")
        return ca.Function("model", [x, u], function(x, u), ["state", "u"], ["theta", "next_state"])

    def jacobian(self, state: Array, u: float) -> Array:
        """Derivative of (theta, next state) by (state, u), shape (1 + S, S + 1)."""
        return np.asarray(self._derivative(state, u))


def _step_jacobian(simulator: Simulator) -> ca.Function:
    """CasADi function (state, u) -> d (theta, next state) / d (state, u)."""
    function = simulator.chain.bound(simulator.dt_s)
    x, u = ca.SX.sym("x", simulator.chain.state_size), ca.SX.sym("u")
    theta, following = function(x, u)
    return dense("jacobian", [x, u], [ca.jacobian(ca.vertcat(theta, following), ca.vertcat(x, u))])
