"""An operator as a PyTorch layer: compiled recursion forward, exact reverse sensitivity back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, final

import casadi as ca
import numpy as np
import torch

from ..kernels.cache import generated_module
from ..model import Array
from ..symbolic.instructions import dense
from ..symbolic.source import scalar_program
from .operator_step import OperatorStep

_DECORATOR = '@njit(cache=True, error_model="numpy", inline="never")\n'


@final
class OperatorLayer:
    """The recursion of an `OperatorStep` over a sequence, with parameters that may change from sample to sample.

    A sequence in PyTorch's own operations costs a dozen of them a sample; the compiled one is free beside a network.
    Derivatives are those of the active branch: step functions have none (S2 section III-C).
    """

    def __init__(self, step: OperatorStep) -> None:
        self.step = step
        self._kernels = _compile(step.function.serialize())
        self._offset, self._slope = torch.tensor(step.offset), torch.tensor(step.slope)

    def start(self, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) that show outputs y (N,)."""
        return self._offset.to(y) + self._slope.to(y) * y[:, None]

    def __call__(self, u: torch.Tensor, p: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs (N, T) and last states (N, S) from inputs (N, T), parameters (N, T, P) and states (N, S)."""
        y, following = _Recursion.apply(u, p, state, self._kernels)
        return y, following

    def __deepcopy__(self, memo: dict[int, Any]) -> OperatorLayer:
        return self  # it never changes, and a CasADi function cannot be copied


@dataclass(frozen=True)
class _Kernels:
    """Compiled `run` and `pull_back` of `operator_loops`, with the numbers of their expressions."""

    run: Callable[..., None]
    pull_back: Callable[..., None]
    forward_constants: Array
    partial_constants: Array


class _Recursion(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Any, p: Any, state: Any, kernels: _Kernels) -> tuple[torch.Tensor, torch.Tensor]:
        ctx.arrays = tuple(np.ascontiguousarray(part.detach().double().numpy()) for part in (u, p))
        ctx.kernels = kernels
        rows, samples = u.shape
        ctx.states = np.empty((rows, samples + 1, state.shape[1]))
        ctx.states[:, 0] = state.detach().numpy()
        y = np.empty((rows, samples))
        kernels.run(ctx.states, *ctx.arrays, y, kernels.forward_constants)
        return torch.from_numpy(y).to(u.dtype), torch.from_numpy(ctx.states[:, -1].copy()).to(u.dtype)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, None]:
        by_y, by_following = grad_outputs
        by_u, by_p = (np.empty_like(part) for part in ctx.arrays)
        by_state = np.array(by_following.double().numpy())
        given = np.ascontiguousarray(by_y.double().numpy())
        ctx.kernels.pull_back(ctx.states, *ctx.arrays, given, by_state, by_u, by_p, ctx.kernels.partial_constants)
        first, second, third = (torch.from_numpy(part).to(by_y.dtype) for part in (by_u, by_p, by_state))
        return first, second, third, None


@lru_cache(maxsize=16)
def _compile(serialized: str) -> _Kernels:
    function = ca.Function.deserialize(serialized)
    x, p = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("p", function.numel_in(2))
    u = ca.SX.sym("u")
    y, following = function(x, u, p)
    by = ca.jacobian
    slopes = [by(following, x), by(following, u), by(y, x), by(y, u), by(following, p), by(y, p)]
    forward = scalar_program(dense("forward_step", [x, u, p], [y, following]), "forward_step")
    partials = scalar_program(dense("partials", [x, u, p], slopes), "partials")
    generated = "".join(_DECORATOR + program.source + "\n\n" for program in (forward, partials))
    loops = resources.files("hystmpc.models.networks").joinpath("operator_loops.py").read_text(encoding="utf-8")
    module = generated_module("import math\n\n\n" + generated + loops)
    return _Kernels(module.run, module.pull_back, np.array(forward.constants), np.array(partials.constants))
