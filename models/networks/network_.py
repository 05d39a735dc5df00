"""Interface of a network: a PyTorch module with explicit state that also writes its ONNX nodes."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import numpy as np
import torch

from hystmpc.trials.types import Vec

from ..contract.metadata import InitialRule
from ..model import StepFunction
from .nodes import GraphWriter, Scaling


class Network(torch.nn.Module, ABC):
    """Network for training, reference and export, with scaled input v and output y (N, T) and state (N, S).

    Attributes:
        context: past samples in an output of a network without a recurrent state; 0 otherwise.
        measured: last entries of the state that start from measured values, not from learned ones.
    """

    state_size: int
    context: int = 0
    measured: int = 0

    def start(self, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) of a device at rest at outputs y (N,); affine in y; zeros if not overridden."""
        return y.new_zeros(len(y), self.state_size)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) during a motion, after the inputs `past` (N, context), at outputs y (N,)."""
        del past
        return self.start(y)

    @abstractmethod
    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs (N, T) and the states (N, S) after the last sample."""

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Outputs (N, T) from which `begin` starts at each sample of motions v (N, T) with measurement y (N, T)."""
        del v
        return y

    @abstractmethod
    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, Sequence[str]]:
        """Write the ONNX nodes of one step; return the names of the output [N,1] and of the parts of the next state."""

    @property
    def matrices(self) -> list[torch.Tensor]:
        """Trained matrices between hidden layers, without heads and single inputs."""
        return [
            p
            for name, p in self.named_parameters()
            if p.requires_grad and p.ndim == 2 and min(p.shape) > 1 and "head" not in name.split(".")
        ]


def numbers(tensor: torch.Tensor) -> np.ndarray:
    """A tensor's values as float64."""
    return tensor.detach().double().numpy()


@final
class TorchStep(StepFunction):
    """Step of a network in the units of the trials; the state is the network's."""

    def __init__(self, net: Network, scaling: Scaling) -> None:
        self.scaling = scaling
        self.state_size = net.state_size
        self._net = copy.deepcopy(net).double().requires_grad_(False)

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        v = torch.tensor(self.scaling.scale_in(np.asarray(u, dtype=np.float64)))
        with torch.no_grad():
            y, following = self._net(v, torch.tensor(np.asarray(state, dtype=np.float64)))
        return self.scaling.to_units(numbers(y)), numbers(following)

    def jacobian(self, state: Vec, u: float) -> Vec:
        """Derivative of (theta, next state) by (state, u), (1 + S, S + 1), by one backward pass over a batch."""
        rows = self.state_size + 1
        point = torch.tensor(np.append(state, self.scaling.scale_in(np.array(u)))).repeat(rows, 1).requires_grad_()
        y, following = self._net(point[:, -1:], point[:, :-1])
        total = torch.cat([self.scaling.theta_scale * y, following], dim=1).diagonal().sum()
        derivative = numbers(torch.autograd.grad(total, point)[0])
        derivative[:, -1] /= self.scaling.u_scale
        return derivative

    def run(self, state: Vec, commands: Vec) -> tuple[Vec, Vec]:
        """Outputs (T,) over inputs (T,) from a state (S,), and the final state."""
        v = torch.tensor(self.scaling.scale_in(commands))[None]
        with torch.no_grad():
            y, following = self._net(v, torch.tensor(state)[None])
        return self.scaling.to_units(numbers(y)[0]), numbers(following)[0]

    def initial_rule(self) -> InitialRule:
        """Initial rule of a trial, from the measured output in its unit."""
        at = [numbers(self._net.start(torch.tensor([y], dtype=torch.float64)))[0] for y in (0.0, 1.0)]
        slope = (at[1] - at[0]) / self.scaling.theta_scale
        return InitialRule(
            offset=tuple((at[0] - slope * self.scaling.theta_offset).tolist()), slope=tuple(slope.tolist())
        )

    @property
    def measured(self) -> int:
        """Last entries of the state that start from measured values."""
        return self._net.measured
