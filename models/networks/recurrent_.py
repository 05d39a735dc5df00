"""Stacked recurrent networks in PyTorch with a linear head: LSTM and GRU."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import torch

from .lstm import LstmLayer, write_layers
from .network_ import Network, numbers
from .nodes import GraphWriter


@final
class LstmNet(Network):
    """Stacked LSTM and linear head on scaled signals, equations in `LstmWeights`.

    The state is [h_1, c_1, h_2, c_2, ...], zero at the start.

    Args:
        memory_samples, command_gain: of the initial weights, see `CellSettings`; the defaults are PyTorch's.
        outputs: number of outputs of the head; more than one for a network inside another.
    """

    def __init__(
        self, hidden: int, layers: int, memory_samples: int = 0, command_gain: float = 1.0, outputs: int = 1
    ) -> None:
        super().__init__()
        self.lstm = torch.nn.LSTM(1, hidden, layers, batch_first=True)
        self.head = torch.nn.Linear(hidden, outputs)
        self.state_size = 2 * layers * hidden
        _initialise(self.lstm, memory_samples, command_gain, (-1.0, 1.0))  # forget bias log(tau), input bias -log(tau)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        outputs, following = self.outputs(v, state)
        return outputs[..., 0], following

    def outputs(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """All outputs (N, T, outputs) of the head and the states after the last sample."""
        rows, layers = len(v), self.lstm.num_layers
        h, c = state.reshape(rows, layers, 2, -1).permute(2, 1, 0, 3).contiguous()
        hidden, following = self.lstm(v[..., None], (h, c))
        return self.head(hidden), torch.stack(following).permute(2, 1, 0, 3).reshape(rows, -1)

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        hidden, following = write_layers(writer, lstm_layers(self), v, state)
        return writer.affine(hidden, "head", numbers(self.head.weight), numbers(self.head.bias), "y"), following


@final
class GruNet(Network):
    """Stacked GRU and linear head, S2 (RA-L 2024) section III-B (Cho et al., EMNLP 2014, in the form of PyTorch).

        r = sigmoid(W_r x + U_r h + b_r),  z = sigmoid(W_z x + U_z h + b_z)
        n = tanh(W_n x + b_n + r (U_n h + c_n)),  h' = (1 - z) n + z h,  y = w . h' + b

    The state is [h_1, h_2, ...], S = layers * hidden entries, zero at the start.
    """

    def __init__(self, hidden: int, layers: int, memory_samples: int = 0, command_gain: float = 1.0) -> None:
        super().__init__()
        self.gru = torch.nn.GRU(1, hidden, layers, batch_first=True)
        self.head = torch.nn.Linear(hidden, 1)
        self.state_size = layers * hidden
        _initialise(self.gru, memory_samples, command_gain, (None, 1.0))  # gate z keeps the state: bias log(tau - 1)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        layers = state.reshape(len(v), self.gru.num_layers, -1).swapaxes(0, 1).contiguous()
        outputs, following = self.gru(v[..., None], layers)
        return self.head(outputs)[..., 0], following.swapaxes(0, 1).reshape(len(v), -1)

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


def _initialise(
    cells: torch.nn.RNNBase, memory_samples: int, command_gain: float, signs: Sequence[float | None]
) -> None:
    """Set gates with memories tau, log-uniform from 1 to `memory_samples` (Tallec and Ollivier, ICLR 2018).

    `signs`: factors of log(tau) in the bias of each of the first gates; None leaves a gate unchanged.
    """
    cells.get_parameter("weight_ih_l0").data.mul_(command_gain)
    if memory_samples:
        hidden = cells.hidden_size
        for k in range(cells.num_layers):
            bias = cells.get_parameter(f"bias_ih_l{k}").data
            memory = torch.rand(hidden) * math.log(memory_samples)
            for gate, sign in enumerate(signs):
                if sign is not None:
                    bias[gate * hidden : (gate + 1) * hidden] = sign * memory


def lstm_layers(net: LstmNet) -> tuple[LstmLayer, ...]:
    """Weights of the layers, with the sum of the two biases of a layer."""
    values = {name: numbers(tensor) for name, tensor in net.lstm.state_dict().items()}
    return tuple(
        LstmLayer(
            values[f"weight_ih_l{k}"], values[f"weight_hh_l{k}"], values[f"bias_ih_l{k}"] + values[f"bias_hh_l{k}"]
        )
        for k in range(net.lstm.num_layers)
    )
