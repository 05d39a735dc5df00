"""Files of small networks whose angle rises with the command, behind a lag; with gates that nobody trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.connections import connected_bundle
from hystmpc.models.contract.export import ExportBundle, model_bytes
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.identify.runs import fixed_rule
from hystmpc.models.motions import flexed
from hystmpc.models.networks.nodes import Scaling, network_step_graph
from hystmpc.models.operators.dynamics import Delay, Lag
from tests.models.lstm_examples import DT, facts, random_weights
from tests.models.zoo import BACKLASH, simulator

FRESH = 2
"""The part of a layer's weights that makes what is new, in either kind."""
Way = Literal["series", "parallel"]
WAYS: dict[Way, Chain] = {"series": Chain(Lag(0.08), before=(Delay(DT, 1),)), "parallel": Chain(BACKLASH)}


def small_network(kind: str, hidden: int, layers: int, folder: Path, said: str | None = None) -> str:
    """File of an LSTM or a GRU between about 30 and 85 deg; `said` is the kind that its file claims."""
    path = folder / f"{kind}_{hidden}_{layers}.onnx"
    path.write_bytes(model_bytes(_small(kind, hidden, layers, (30.0, 85.0), said)))
    return str(path)


def gated_network(folder: Path) -> str:
    """File of a gated LSTM with a lag and plays, between about 30 and 85 deg."""
    torch = pytest.importorskip("torch", reason="torch is an extra")
    from hystmpc.models.networks.settings import DeviceFacts, GatedSettings

    torch.manual_seed(3)
    net = GatedSettings(hidden=7, plays=3).network(DeviceFacts(-1.0, None, 1.0))
    with torch.no_grad():
        for name, weight in net.named_parameters():
            if "head" in name:
                weight.copy_(torch.rand_like(weight))
    path = folder / "gated.onnx"
    path.write_bytes(model_bytes(_bundle(net, "lstm", (30.0, 85.0))))
    return str(path)


def connected_network(ways: tuple[Way, ...], folder: Path) -> str:
    """File of a small LSTM with operators in series or in parallel, the outermost first."""
    beside = "parallel" in ways
    bundle = _small("lstm", 5, 1, (-2.0, 2.0) if beside else (30.0, 85.0))
    for way in reversed(ways):
        operators = simulator(WAYS[way])
        bundle = connected_bundle(operators, way, bundle, operators.metadata() if beside else bundle.metadata)
    path = folder / f"{'_'.join(ways)}.onnx"
    path.write_bytes(model_bytes(bundle))
    return str(path)


def _small(kind: str, hidden: int, layers: int, angles: tuple[float, float], said: str | None = None) -> ExportBundle:
    torch = pytest.importorskip("torch", reason="torch is an extra")
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
    return _bundle(net, kind, angles, said)


def _bundle(net: Any, kind: str, angles: tuple[float, float], said: str | None = None) -> ExportBundle:
    """A network scaled so that it goes from the lower to the upper angle [deg] between 0 and 6 mm."""
    from hystmpc.models.networks.network_ import TorchStep

    scaling = Scaling(3.0, 3.0, 0.0, 1.0)
    low, high = (_held(TorchStep(net, scaling), u) for u in (0.0, 6.0))
    gain = (angles[1] - angles[0]) / (high - low)
    scaling = replace(scaling, theta_offset=angles[0] - gain * low, theta_scale=gain)
    step, own = TorchStep(net, scaling), facts(random_weights(5, 1))
    about: ModelMetadata = own.model_copy(
        update={
            "kind": said or kind,
            "initial": fixed_rule(np.zeros(step.state_size)),
            "conditioned": fixed_rule(flexed(step, np.zeros(step.state_size), own.trained_command, DT, 5)),
        }
    )
    graph = network_step_graph(kind, net.state_size, scaling, net.write)
    return ExportBundle(graph, about, step, np.linspace(0.0, 6.0, 50))


def _held(step: Any, u: float) -> float:
    """Scaled angle after many samples of a command."""
    state, angle = np.zeros((1, step.state_size)), np.zeros((1, 1))
    for _ in range(100):
        angle, state = step.advance(state, np.array([[u]]))
    return float(angle.item())
