"""The trainable twin of `LstmWeights` in PyTorch (extra `train`)."""

from __future__ import annotations

import numpy as np
import torch

from .weights import LstmLayer, LstmScaling, LstmWeights

State = tuple[torch.Tensor, torch.Tensor]


class LstmNet(torch.nn.Module):
    """Stacked LSTM and linear head on scaled signals: v (N, T) -> y (N, T), state (h, c) of (L, N, H) each."""

    def __init__(self, hidden: int, layers: int) -> None:
        super().__init__()
        self.lstm = torch.nn.LSTM(1, hidden, layers, batch_first=True)
        self.head = torch.nn.Linear(hidden, 1)

    def forward(self, v: torch.Tensor, state: State | None = None) -> tuple[torch.Tensor, State]:
        """Scaled angles (N, T) and the state after the last sample; zero state where none is given."""
        outputs, following = self.lstm(v[..., None], state)
        return self.head(outputs)[..., 0], following


def weights_of(net: LstmNet, scaling: LstmScaling) -> LstmWeights:
    """Copy the numbers out of `net`; its two biases a layer, which only ever act together, are added."""
    values = {name: tensor.detach().numpy().astype(np.float64) for name, tensor in net.state_dict().items()}
    layers = [
        LstmLayer(
            values[f"lstm.weight_ih_l{k}"],
            values[f"lstm.weight_hh_l{k}"],
            values[f"lstm.bias_ih_l{k}"] + values[f"lstm.bias_hh_l{k}"],
        )
        for k in range(net.lstm.num_layers)
    ]
    return LstmWeights(tuple(layers), values["head.weight"][0], float(values["head.bias"][0]), scaling)


def net_of(weights: LstmWeights) -> LstmNet:
    """A network with these weights, for further training."""
    net = LstmNet(weights.hidden, len(weights.layers))
    values = {"head.weight": weights.head_weight[None], "head.bias": [weights.head_bias]}
    for k, layer in enumerate(weights.layers):
        values |= {f"lstm.weight_ih_l{k}": layer.w_ih, f"lstm.weight_hh_l{k}": layer.w_hh}
        values |= {f"lstm.bias_ih_l{k}": layer.bias, f"lstm.bias_hh_l{k}": np.zeros_like(layer.bias)}
    net.load_state_dict({name: torch.tensor(np.asarray(v), dtype=torch.float32) for name, v in values.items()})
    return net
