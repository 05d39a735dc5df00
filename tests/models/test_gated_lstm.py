"""The increment-gated LSTM: a hold holds, the gate counts travel, and its kernels are the network in PyTorch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import numpy_helper

from hystmpc.models.evaluate import free_run
from hystmpc.models.kernels.gated import GatedLstmRoute, pack_gated_lstm
from hystmpc.models.networks.nodes import Scaling, network_step_graph
from hystmpc.models.networks.settings import DeviceFacts, GatedSettings
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.prediction.exported import RoutedPredictor
from hystmpc.trials.errors import ModelError

from .tiny_kinds import FORWARD, example

torch = pytest.importorskip("torch", reason="torch is an extra")
from hystmpc.models.networks.network_ import TorchStep  # noqa: E402  (needs torch)

SCALING = Scaling(3.0, 3.0, 60.0, 32.0)
LAG = 1.0  # samples
ARRIVED = 14  # samples after which a lag of one sample has come within 1e-5 of any step of two
FORMS = {
    "lag, plays and gate": (GatedSettings(hidden=7, plays=5), DeviceFacts(-1.0, None, LAG)),
    "without lag": (GatedSettings(), DeviceFacts(-1.0)),
    "inverse map": (GatedSettings(hidden=5), DeviceFacts(-1.0, inverted=True)),
    "without plays": (GatedSettings(hidden=6, plays=0), DeviceFacts(-1.0, None, LAG)),
    "without gate": (GatedSettings(hidden=6, plays=3, path=None), DeviceFacts(-1.0, None, LAG)),
}
HOLDING = [name for name in FORMS if name != "without gate"]
every_form = pytest.mark.parametrize("form", FORMS)
commands = st.lists(st.floats(0.0, 6.0), min_size=1, max_size=30)


def network(form: str, seed: int = 1):  # type: ignore[no-untyped-def]
    torch.manual_seed(seed)
    chosen, facts = FORMS[form]
    net = chosen.network(facts)
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2.0)  # gates that open and close
    return net


def route_of(net) -> GatedLstmRoute:  # type: ignore[no-untyped-def]
    graph = network_step_graph("lstm", net.state_size, SCALING, net.write)
    return GatedLstmRoute({t.name: numpy_helper.to_array(t) for t in graph.initializer})


ROUTES = {name: route_of(network(name)) for name in FORMS}
STEPS = {name: TorchStep(network(name), SCALING) for name in FORMS}


@pytest.mark.parametrize("form", HOLDING)
@settings(max_examples=50, deadline=None)
@given(history=commands, held=st.floats(0.0, 6.0))
def test_a_held_command_holds_the_angle_to_the_last_bit(form: str, history: list[float], held: float) -> None:
    motion = np.array([*history, *[held] * ARRIVED])
    step, route = STEPS[form], ROUTES[form]
    _, state = step.run(step.initial_rule().state(np.zeros((1, 1)))[0], motion)
    first = step.advance(state[None], np.array([[held]]))
    later = step.advance(first[1], np.array([[held]]))
    np.testing.assert_array_equal(first[1], state[None])
    np.testing.assert_array_equal(later[0], first[0])
    angles, after = route.advance(np.full(step.state_size, 0.1), np.array([*motion, *[held] * 200]))
    assert np.ptp(angles[len(motion) :]) == 0.0
    np.testing.assert_array_equal(route.advance(after, np.array([held]))[1], after)


def test_without_the_gate_a_hold_drifts() -> None:
    angles, _ = ROUTES["without gate"].advance(np.full(network("without gate").state_size, 0.1), np.full(200, 3.0))
    assert np.ptp(angles[ARRIVED : ARRIVED + 20]) > 0.01


def test_the_gate_counts_travel_and_not_time() -> None:
    """Pauses of any length anywhere leave the angles of a motion as they are."""
    net, rng = network("without lag").double(), np.random.default_rng(0)
    motion = rng.uniform(-1, 1, 40)
    repeats = rng.integers(1, 9, motion.size)
    with torch.no_grad():
        start = net.start(torch.zeros(1, dtype=torch.float64))
        plain = net(torch.tensor(motion[None]), start)[0][0].numpy()
        paused = net(torch.tensor(np.repeat(motion, repeats)[None]), start)[0][0].numpy()
    np.testing.assert_allclose(paused[np.cumsum(repeats) - 1], plain, rtol=0, atol=1e-12)


def reference(net, state: np.ndarray, plan: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Angles, Jacobian and the state behind the plan."""

    def run(plan):  # type: ignore[no-untyped-def]
        x, angles = torch.tensor(state[None]), []
        for k in range(len(plan)):
            y, x = net(((plan[k] - SCALING.u_offset) / SCALING.u_scale).reshape(1, 1), x)
            angles.append(SCALING.theta_offset + SCALING.theta_scale * y[0, 0])
        return torch.stack(angles), x[0]

    with torch.no_grad():
        angles, after = run(torch.tensor(plan))
    slopes = torch.autograd.functional.jacobian(lambda c: run(c)[0], torch.tensor(plan))
    return angles.numpy(), slopes.numpy(), after.numpy()


@pytest.mark.slow
@every_form
def test_kernels_are_exact_from_any_state(form: str) -> None:
    net, route = network(form).double(), ROUTES[form]
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


@every_form
def test_sample_moves_only_the_rows_that_it_is_asked_for(form: str) -> None:
    net, route = network(form), ROUTES[form]
    states, theta = np.random.default_rng(0).uniform(-0.9, 0.9, (2, net.state_size)), np.full(2, np.nan)
    kept = states.copy()
    route.sample(route.packed, states, 1, np.array([2.0, 3.0]), theta)
    angles, following = route.advance(kept[0], np.array([2.0]))
    np.testing.assert_allclose(theta[0], angles[0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(states[0], following, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(states[1], kept[1])
    assert np.isnan(theta[1])


@pytest.mark.slow
def test_the_default_lstm_holds_in_its_file_and_behind_its_predictor() -> None:
    """onnxruntime and the kernels, after a motion that was recorded: not a bit of drift in a minute."""
    one = example("lstm", FORWARD)
    predictor = predictor_for(one.model)
    assert isinstance(predictor, RoutedPredictor)
    commands = np.concatenate([one.trials[0].command[:60], np.full(1500, 2.2)])
    theta = free_run(one.model, commands, 40.0)
    assert np.ptp(theta[:60]) > 5.0
    assert np.ptp(theta[60 + 50 :]) == 0.0
    followed = predictor.rollout(predictor.initial(40.0, float(commands[0])), commands[None])[0]
    assert np.ptp(followed[60 + 50 :]) == 0.0


def test_missing_weights_are_named() -> None:
    with pytest.raises(ModelError, match=r"gated LSTM: no array lstm\.0\.w_ih"):
        pack_gated_lstm({"head.weight": np.zeros((1, 4))})
