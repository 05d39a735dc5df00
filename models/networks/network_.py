"""What a network is: a PyTorch module on scaled signals with explicit state, which also writes its own ONNX nodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch

from .nodes import GraphWriter


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
