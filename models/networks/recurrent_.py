"""Gated recurrent units in PyTorch, stacked, with a linear head."""

from __future__ import annotations

from typing import final

import torch

from .network_ import Network, numbers
from .nodes import GraphWriter


@final
class GruNet(Network):
    """Stacked GRU and linear head, S2 section III-B (Cho et al., EMNLP 2014, in the form of PyTorch).

        r = sigmoid(W_r x + U_r h + b_r),  z = sigmoid(W_z x + U_z h + b_z)
        n = tanh(W_n x + b_n + r (U_n h + c_n)),  h' = (1 - z) n + z h,  y = w . h' + b

    The state is [h_1, h_2, ...], S = layers * hidden entries, zero at the start.
    """

    def __init__(self, hidden: int, layers: int) -> None:
        super().__init__()
        self.gru = torch.nn.GRU(1, hidden, layers, batch_first=True)
        self.head = torch.nn.Linear(hidden, 1)
        self.state_size = layers * hidden

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return y.new_zeros(len(y), self.state_size)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del past
        return self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        layers = state.reshape(len(v), self.gru.num_layers, -1).swapaxes(0, 1).contiguous()
        outputs, following = self.gru(v[..., None], layers)
        return self.head(outputs)[..., 0], following.swapaxes(0, 1).reshape(len(v), -1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        count, hidden = self.gru.num_layers, self.gru.hidden_size
        writer.split(state, [hidden] * count, [f"h_{k}" for k in range(count)])
        x, one = v, writer.weight("one", [[1.0]])
        for k in range(count):
            x = self._write_layer(writer, k, x, one)
        y = writer.affine(x, "head", numbers(self.head.weight), numbers(self.head.bias), "y")
        return y, [f"h_{k}_next" for k in range(count)]

    def _write_layer(self, writer: GraphWriter, k: int, x: str, one: str) -> str:
        hidden = self.gru.hidden_size
        for source, side in ((x, "ih"), (f"h_{k}", "hh")):
            weight, bias = (numbers(self.gru.get_parameter(f"{part}_{side}_l{k}")) for part in ("weight", "bias"))
            writer.affine(source, f"gru.{k}.{side}", weight, bias, f"a_{side}_{k}")
            writer.split(f"a_{side}_{k}", [hidden] * 3, [f"{gate}_{side}_{k}" for gate in "rzn"])
        for gate in "rz":
            writer.node("Add", [f"{gate}_ih_{k}", f"{gate}_hh_{k}"], f"{gate}_sum_{k}")
            writer.node("Sigmoid", [f"{gate}_sum_{k}"], f"{gate}_{k}")
        writer.node("Mul", [f"r_{k}", f"n_hh_{k}"], f"reset_{k}")
        writer.node("Add", [f"n_ih_{k}", f"reset_{k}"], f"n_sum_{k}")
        writer.node("Tanh", [f"n_sum_{k}"], f"n_{k}")
        writer.node("Sub", [one, f"z_{k}"], f"fresh_{k}")
        writer.node("Mul", [f"fresh_{k}", f"n_{k}"], f"new_{k}")
        writer.node("Mul", [f"z_{k}", f"h_{k}"], f"kept_{k}")
        return writer.node("Add", [f"new_{k}", f"kept_{k}"], f"h_{k}_next")
