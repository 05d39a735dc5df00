"""Compiled roll-outs of operator chains and of exported models with elementwise operations."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Self, final

import casadi as ca
import numpy as np

from hystmpc.core.chain import ChainCode, PreparedChain
from hystmpc.core.structs import Struct, struct
from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..model import InvertiblePredictor, kind_of
from ..program import dense
from ..simulator import Simulator
from ..stages import function_program, prepared


@final
class CompiledPredictor(InvertiblePredictor):
    """Compiled roll-out and linearisation of a symbolic step (state, u, p, dt) -> (theta, next state).

    Args:
        run: the same step for the engine; that of the expression as a whole where left out.

    Attributes:
        parameters, sample_s: p (P,) and dt [s].
    """

    def __init__(self, transition: Any, p: Vec, metadata: ModelMetadata, run: PreparedChain | None = None) -> None:
        super().__init__(metadata)
        self.transition, self._facts = transition, metadata
        self.parameters, self.sample_s = np.asarray(p, dtype=np.float64), metadata.dt_s
        self.run = run or PreparedChain(ChainCode([function_program(transition)]), self.parameters, metadata.dt_s)

    @classmethod
    def of_simulator(cls, simulator: Simulator) -> CompiledPredictor:
        """Predictor of a simulator at its sample time."""
        chain, facts = simulator.chain, simulator.metadata()
        return cls(chain.transition, chain.values, facts, prepared(chain.operators, facts.dt_s))

    @classmethod
    def of_function(cls, function: Any, metadata: ModelMetadata) -> CompiledPredictor:
        """Predictor of a CasADi SX function (state, u) -> (theta, next state) of an exported model."""
        x, u = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("u")
        theta, following = function(x, u)
        transition = dense("transition", [x, u, ca.SX.sym("p", 0), ca.SX.sym("dt")], [theta, following])
        return cls(transition, np.empty(0), metadata)

    @property
    def state_size(self) -> int:
        return self.run.code.states

    @cached_property
    def part(self) -> Struct:
        code, kept = self.run.code, self.run.kept
        return struct("hystmpc_predictor", kind=kind_of("CHAIN"), states=code.states, chain=code.code, kept=kept)

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
        return self.run.step(state, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self.run.roll_out(state, plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        return self.run.linearise(state, plan)

    def command_for(self, state: Vec, theta: float, low: float, high: float, last: float) -> float:
        return self.run.command_for(state, theta, low, high, last)
