"""A network as the reference of its own export: the PyTorch module in double precision, Jacobian by autograd."""

from __future__ import annotations

import copy
from typing import final

import numpy as np
import torch

from ..contract.metadata import InitialRule
from ..model import Array, StepFunction
from .network_ import Network, numbers
from .scaling import Scaling


@final
class TorchStep(StepFunction):
    """One step of a network in the units of the trials; the state is the network's own."""

    def __init__(self, net: Network, scaling: Scaling) -> None:
        self.scaling = scaling
        self.state_size = net.state_size
        self._net = copy.deepcopy(net).double().requires_grad_(False)

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Outputs (N, 1) and next states (N, S) from states (N, S) and inputs (N, 1)."""
        v = torch.tensor(self.scaling.scale_in(np.asarray(u, dtype=np.float64)))
        with torch.no_grad():
            y, following = self._net(v, torch.tensor(np.asarray(state, dtype=np.float64)))
        return self.scaling.to_units(numbers(y)), numbers(following)

    def jacobian(self, state: Array, u: float) -> Array:
        """Derivative of (theta, next state) by (state, u) at one point, shape (1 + S, S + 1).

        Row i of a batch of 1 + S equal points stands for output i, so that one backward pass gives all rows.
        """
        rows = self.state_size + 1
        point = torch.tensor(np.append(state, self.scaling.scale_in(np.array(u)))).repeat(rows, 1).requires_grad_()
        y, following = self._net(point[:, -1:], point[:, :-1])
        total = torch.cat([self.scaling.theta_scale * y, following], dim=1).diagonal().sum()
        derivative = numbers(torch.autograd.grad(total, point)[0])
        derivative[:, -1] /= self.scaling.u_scale
        return derivative

    def run(self, state: Array, commands: Array) -> tuple[Array, Array]:
        """Outputs (T,) over inputs (T,) from a state (S,), and the state after them."""
        v = torch.tensor(self.scaling.scale_in(commands))[None]
        with torch.no_grad():
            y, following = self._net(v, torch.tensor(state)[None])
        return self.scaling.to_units(numbers(y)[0]), numbers(following)[0]

    def initial_rule(self) -> InitialRule:
        """Start of a trial, from the measured output in its unit."""
        at = [numbers(self._net.start(torch.tensor([y], dtype=torch.float64)))[0] for y in (0.0, 1.0)]
        slope = (at[1] - at[0]) / self.scaling.theta_scale
        return InitialRule(
            offset=tuple((at[0] - slope * self.scaling.theta_offset).tolist()), slope=tuple(slope.tolist())
        )

    @property
    def measured(self) -> int:
        """Last entries of the state that start from what is measured."""
        return self._net.measured
