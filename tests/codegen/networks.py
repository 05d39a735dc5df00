"""Files of small networks whose angle rises with the command, behind a lag; with gates that nobody trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.contract.export import ExportBundle, model_bytes
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.identify.runs import fixed_rule
from hystmpc.models.motions import flexed
from hystmpc.models.networks.nodes import Scaling, network_step_graph
from tests.models.lstm_examples import DT, facts, random_weights

FRESH = 2
"""The part of a layer's weights that makes what is new, in either kind."""


def small_network(kind: str, hidden: int, layers: int, folder: Path, said: str | None = None) -> str:
    """File of an LSTM or a GRU between about 30 and 85 deg; `said` is the kind that its file claims."""
    torch = pytest.importorskip("torch", reason="torch is an extra")
    from hystmpc.models.networks.network_ import TorchStep
    from hystmpc.models.networks.recurrent_ import GruNet, LstmNet

    torch.manual_seed(hidden)
    net = (GruNet if kind == "gru" else LstmNet)(hidden, layers)
    with torch.no_grad():
        for name, weight in net.named_parameters():
            weight.mul_(0.3)
            if "weight_ih" in name:
                rows = slice(FRESH * hidden, (FRESH + 1) * hidden)
                weight[rows] = torch.rand_like(weight[rows]) * (1.5 / weight.shape[1])
            if name == "head.weight":
                weight.copy_(torch.rand_like(weight) / hidden)
    scaling = Scaling(3.0, 3.0, 0.0, 1.0)
    low, high = (_held(TorchStep(net, scaling), u) for u in (0.0, 6.0))
    gain = 55.0 / (high - low)
    scaling = replace(scaling, theta_offset=30.0 - gain * low, theta_scale=gain)
    step = TorchStep(net, scaling)
    about: ModelMetadata = facts(random_weights(5, 1)).model_copy(
        update={
            "kind": said or kind,
            "initial": fixed_rule(np.zeros(step.state_size)),
            "conditioned": fixed_rule(
                flexed(step, np.zeros(step.state_size), facts(random_weights(5, 1)).trained_command, DT, 5)
            ),
        }
    )
    graph = network_step_graph(kind, net.state_size, scaling, net.write)
    path = folder / f"{kind}_{hidden}_{layers}.onnx"
    path.write_bytes(model_bytes(ExportBundle(graph, about, step, np.linspace(0.0, 6.0, 50))))
    return str(path)


def _held(step: object, u: float) -> float:
    """Scaled angle after many samples of a command."""
    state, angle = np.zeros((1, step.state_size)), np.zeros((1, 1))  # type: ignore[attr-defined]
    for _ in range(100):
        angle, state = step.advance(state, np.array([[u]]))  # type: ignore[attr-defined]
    return float(angle.item())
