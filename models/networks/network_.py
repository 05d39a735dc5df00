"""What a network is: a PyTorch module with explicit state that also writes its own ONNX nodes; the plainest of them."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import final

import numpy as np
import torch

from hystmpc.trials.types import Vec

from ..contract.metadata import InitialRule
from ..model import StepFunction
from .nodes import GraphWriter, Scaling


class Network(torch.nn.Module, ABC):
    """One definition of a network, for training, as reference and for export.

    Signals are scaled: input v and output y (N, T), state (N, S). Implementations are final.

    Attributes:
        state_size: S.
        context: past samples that an output looks back on, for networks without a recurrent state; 0 otherwise.
        measured: last entries of the state that start from what is measured, not from what the network has learned.
    """

    state_size: int
    context: int = 0
    measured: int = 0

    @abstractmethod
    def start(self, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) of a device at rest that shows outputs y (N,); affine in y."""

    @abstractmethod
    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) in the middle of a motion after the inputs `past` (N, context), at outputs y (N,)."""

    @abstractmethod
    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs (N, T) and the states (N, S) after the last sample."""

    @abstractmethod
    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """What `begin` starts from at each sample (N, T) of whole motions v (N, T), measured as y (N, T)."""

    @abstractmethod
    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, Sequence[str]]:
        """ONNX nodes of one step: names of the output [N,1] and of the parts of the next state."""

    @property
    def matrices(self) -> list[torch.Tensor]:
        """Trained matrices between hidden layers, heads and single inputs left out."""
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
    """One step of a network in the units of the trials; the state is the network's own."""

    def __init__(self, net: Network, scaling: Scaling) -> None:
        self.scaling = scaling
        self.state_size = net.state_size
        self._net = copy.deepcopy(net).double().requires_grad_(False)

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Outputs (N, 1) and next states (N, S) from states (N, S) and inputs (N, 1)."""
        v = torch.tensor(self.scaling.scale_in(np.asarray(u, dtype=np.float64)))
        with torch.no_grad():
            y, following = self._net(v, torch.tensor(np.asarray(state, dtype=np.float64)))
        return self.scaling.to_units(numbers(y)), numbers(following)

    def jacobian(self, state: Vec, u: float) -> Vec:
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

    def run(self, state: Vec, commands: Vec) -> tuple[Vec, Vec]:
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


@final
class FeedForwardNet(Network):
    """y_k = W_n relu(... relu(W_1 [v_{k-n+1}, ..., v_k] + b_1) ...) + b_n, FNN and FNN-HIB.

    Source: S2 (RA-L 2024) section III-B.

    The state holds the n - 1 past inputs, oldest first. With n = 1 it is the last input, which is not read: a step of
    the contract has at least one entry.

    Args:
        hidden: widths of the layers.
        history: n.
        rest: scaled input with which the buffer is filled at the start (S2 pads with u = 0 or theta = 30 deg).
    """

    def __init__(self, hidden: Sequence[int], history: int, rest: float) -> None:
        super().__init__()
        widths = [history, *hidden]
        self.hidden = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in pairwise(widths))
        self.head = torch.nn.Linear(widths[-1], 1)
        self.history, self.rest = history, rest
        self.context, self.state_size = history - 1, max(1, history - 1)

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return torch.full((len(y), self.state_size), self.rest, dtype=y.dtype)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return past if self.context else self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        line = torch.cat([state, v], dim=1)
        x = line[:, self.state_size - self.context :].unfold(1, self.history, 1)
        for layer in self.hidden:
            x = torch.relu(layer(x))
        return self.head(x)[..., 0], line[:, -self.state_size :]

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        x = writer.join([state, v], "line") if self.context else v
        for k, layer in enumerate(self.hidden):
            z = writer.affine(x, f"hidden.{k}", *_numbers_of(layer), f"z_{k}")
            x = writer.node("Relu", [z], f"x_{k}")
        y = writer.affine(x, "head", *_numbers_of(self.head), "y")
        if self.state_size == 1:
            return y, [v]
        kept = writer.split(state, [1, self.state_size - 1], ["oldest", "kept"])[1]
        return y, [kept, v]


def _numbers_of(layer: torch.nn.Module) -> tuple[np.ndarray, np.ndarray]:
    return numbers(layer.get_parameter("weight")), numbers(layer.get_parameter("bias"))
