"""Compiled roll-outs of operator chains and of exported models with elementwise operations."""

from __future__ import annotations

from typing import Any, Self, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..kernels.chain_kernels import compile_step
from ..kernels.program import dense
from ..model import InvertiblePredictor
from ..simulator import Simulator


@final
class CompiledPredictor(InvertiblePredictor):
    """Compiled roll-out and linearisation of a symbolic step (state, u, p, dt) -> (theta, next state).

    Attributes:
        parameters, sample_s: p (P,) and dt (1,) [s], as the kernels take them.
    """

    def __init__(self, transition: Any, p: Vec, metadata: ModelMetadata) -> None:
        super().__init__(metadata)
        self.transition, self._facts = transition, metadata
        self.kernels = compile_step(transition)
        self.parameters, self.sample_s = np.asarray(p, dtype=np.float64), np.array([metadata.dt_s])

    @classmethod
    def of_simulator(cls, simulator: Simulator) -> CompiledPredictor:
        """Predictor of a simulator at its sample time."""
        return cls(simulator.chain.transition, simulator.chain.values, simulator.metadata())

    @classmethod
    def of_function(cls, function: Any, metadata: ModelMetadata) -> CompiledPredictor:
        """Predictor of a CasADi SX function (state, u) -> (theta, next state) of an exported model."""
        x, u = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("u")
        theta, following = function(x, u)
        transition = dense("transition", [x, u, ca.SX.sym("p", 0), ca.SX.sym("dt")], [theta, following])
        return cls(transition, np.empty(0), metadata)

    def held(self, samples: int) -> Self:
        """Predictor of the angle after a hold of so many samples; its state still advances by one sample."""
        if samples == 1:
            return self
        function = self.transition
        x, u = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("u")
        p, dt = ca.SX.sym("p", function.numel_in(2)), ca.SX.sym("dt")
        theta, following = function(x, u, p, dt)
        after = following
        for _ in range(samples - 1):
            theta, after = function(after, u, p, dt)
        return type(self)(dense("held", [x, u, p, dt], [theta, following]), self.parameters, self._facts)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        following, theta, run = state.reshape(1, -1).copy(), np.empty((1, 1)), self.kernels
        run.simulate(following, np.array([[u]]), self.parameters, self.sample_s, run.step_constants, theta)
        return float(theta[0, 0]), following[0]

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        plans = np.ascontiguousarray(plans, dtype=np.float64)
        theta, run = np.empty(plans.shape), self.kernels
        run.rollout(state, plans, self.parameters, self.sample_s, run.step_constants, theta)
        return theta

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        plan = np.ascontiguousarray(plan, dtype=np.float64)
        theta, jacobian, run = np.empty(plan.size), np.empty((plan.size, plan.size)), self.kernels
        run.linearise(state, plan, self.parameters, self.sample_s, run.tangent_constants, theta, jacobian)
        return theta, jacobian

    def command_for(self, state: Vec, theta: float, low: float, high: float, last: float) -> float:
        run = self.kernels
        u = run.command_for(state, theta, low, high, last, self.parameters, self.sample_s, run.slope_constants)
        return float(u)
