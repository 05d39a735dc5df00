"""The feed-forward networks of S2 (RA-L 2024): over the present command, and over a window of commands."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import final

import numpy as np
import torch

from hystmpc.models.networks.network_ import Network, numbers
from hystmpc.models.networks.nodes import GraphWriter


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
