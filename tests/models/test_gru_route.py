"""The GRU in the engine against the network in PyTorch, in double precision."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import numpy_helper

from hystmpc.models.networks.nodes import Scaling, network_step_graph
from hystmpc.models.networks.packed import weights_of
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.networks.settings import DeviceFacts, RecurrentSettings
from hystmpc.trials.errors import ModelError

from .lstm_examples import LEVELS, needs

torch = pytest.importorskip("torch", reason="torch is an extra")

SCALING = Scaling(3.0, 3.0, 60.0, 32.0)
every_size = pytest.mark.parametrize("size", [(5, 1), (64, 2), (7, 3)], ids=str)
every_level = pytest.mark.parametrize("level", LEVELS)


def network(size: tuple[int, int], level: str):  # type: ignore[no-untyped-def]
    torch.manual_seed(1)
    hidden, layers = size
    settings = RecurrentSettings(cell="gru", hidden=hidden, layers=layers, memory_samples=0, command_gain=1.0)
    net = settings.network(DeviceFacts())
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2.0)  # gates that open and close
    graph = network_step_graph("gru", net.state_size, SCALING, net.write)
    arrays = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    return net.double(), NetworkRoute(weights_of("gru", arrays), level=needs(level))


def reference(net, state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Angles, Jacobian and the state behind the plan."""

    def run(commands):  # type: ignore[no-untyped-def]
        x, angles = torch.tensor(state[None]), []
        for k in range(plan.size):
            y, x = net(((commands[k] - SCALING.u_offset) / SCALING.u_scale).reshape(1, 1), x)
            angles.append(SCALING.theta_offset + SCALING.theta_scale * y[0, 0])
        return torch.stack(angles), x[0]

    commands = torch.tensor(plan)
    with torch.no_grad():
        angles, after = run(commands)
    slopes = torch.autograd.functional.jacobian(lambda c: run(c)[0], commands)
    return angles.numpy(), slopes.numpy(), after.numpy()


@pytest.mark.slow
@every_level
@every_size
def test_exact_from_any_state(size: tuple[int, int], level: str) -> None:
    net, route = network(size, level)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        state, plan = rng.uniform(-0.9, 0.9, net.state_size), rng.uniform(0, 6, 20)
        angles, slopes, after = reference(net, state, plan)
        found, jacobian = route.linearise(state, plan)
        np.testing.assert_allclose(found, angles, rtol=0, atol=1e-4)
        np.testing.assert_allclose(jacobian, slopes, rtol=0, atol=1e-4 * np.abs(slopes).max())
        assert np.array_equal(jacobian, np.tril(jacobian))
        stepped, following = route.advance(state, plan)
        np.testing.assert_allclose(stepped, angles, rtol=0, atol=1e-4)
        np.testing.assert_allclose(following, after, rtol=0, atol=1e-5)
        plans = np.stack([plan[::-1], plan] * 40)  # more than a chunk
        np.testing.assert_allclose(route.rollout(state, plans)[1::2], np.tile(angles, (40, 1)), rtol=0, atol=1e-4)


def test_missing_weights_are_named() -> None:
    with pytest.raises(ModelError, match=r"GRU: no array gru\.0\.ih\.weight"):
        weights_of("gru", {"head.weight": np.zeros((1, 4))})
