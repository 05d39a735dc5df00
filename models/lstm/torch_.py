"""The trainable twin of `LstmWeights` in PyTorch (extra `train`)."""

from __future__ import annotations

from typing import final

import numpy as np
import torch

from ..networks.network_ import Network, numbers
from ..networks.nodes import GraphWriter
from ..networks.scaling import Scaling
from .graph import write_layers
from .weights import LstmLayer, LstmWeights


@final
class LstmNet(Network):
    """Stacked LSTM and linear head on scaled signals, equations in `LstmWeights`.

    The state is [h_1, c_1, h_2, c_2, ...], zero at the start.

    Args:
        hidden: cells in a layer.
        layers: number of layers.
        outputs: numbers that the head gives a sample; more than one for a network inside another.
    """

    def __init__(self, hidden: int, layers: int, outputs: int = 1) -> None:
        super().__init__()
        self.lstm = torch.nn.LSTM(1, hidden, layers, batch_first=True)
        self.head = torch.nn.Linear(hidden, outputs)
        self.state_size = 2 * layers * hidden

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return y.new_zeros(len(y), self.state_size)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del past
        return self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        outputs, following = self.outputs(v, state)
        return outputs[..., 0], following

    def outputs(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """All outputs (N, T, outputs) of the head and the states after the last sample."""
        rows, layers = len(v), self.lstm.num_layers
        h, c = state.reshape(rows, layers, 2, -1).permute(2, 1, 0, 3).contiguous()
        hidden, following = self.lstm(v[..., None], (h, c))
        return self.head(hidden), torch.stack(following).permute(2, 1, 0, 3).reshape(rows, -1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        hidden, following = write_layers(writer, lstm_layers(self), v, state)
        return writer.affine(hidden, "head", numbers(self.head.weight), numbers(self.head.bias), "y"), following


def lstm_layers(net: LstmNet) -> tuple[LstmLayer, ...]:
    """The layers' numbers; the two biases of a layer, which only ever act together, are added."""
    values = {name: numbers(tensor) for name, tensor in net.lstm.state_dict().items()}
    return tuple(
        LstmLayer(
            values[f"weight_ih_l{k}"], values[f"weight_hh_l{k}"], values[f"bias_ih_l{k}"] + values[f"bias_hh_l{k}"]
        )
        for k in range(net.lstm.num_layers)
    )


def weights_of(net: LstmNet, scaling: Scaling) -> LstmWeights:
    """Copy the numbers out of a network with one output."""
    return LstmWeights(lstm_layers(net), numbers(net.head.weight)[0], float(numbers(net.head.bias)[0]), scaling)


def net_of(weights: LstmWeights) -> LstmNet:
    """A network with these weights, for further training."""
    net = LstmNet(weights.hidden, len(weights.layers))
    values = {"head.weight": weights.head_weight[None], "head.bias": [weights.head_bias]}
    for k, layer in enumerate(weights.layers):
        values |= {f"lstm.weight_ih_l{k}": layer.w_ih, f"lstm.weight_hh_l{k}": layer.w_hh}
        values |= {f"lstm.bias_ih_l{k}": layer.bias, f"lstm.bias_hh_l{k}": np.zeros_like(layer.bias)}
    net.load_state_dict({name: torch.tensor(np.asarray(v), dtype=torch.float32) for name, v in values.items()})
    return net
