"""The increment-gated LSTM: a hold holds, the gate counts travel, and in the engine it is the network in PyTorch."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import numpy_helper

from hystmpc.models.evaluate import free_run
from hystmpc.models.networks.lstm import GATED_MARK
from hystmpc.models.networks.nodes import Scaling, network_step_graph
from hystmpc.models.networks.packed import weights_of
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.networks.settings import DeviceFacts, GatedSettings
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.prediction.exported import RoutedPredictor
from hystmpc.trials.errors import ModelError

from .lstm_examples import LEVELS, needs
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
every_level = pytest.mark.parametrize("level", LEVELS)
commands = st.lists(st.floats(0.0, 6.0), min_size=1, max_size=30)


def network(form: str, seed: int = 1):  # type: ignore[no-untyped-def]
    torch.manual_seed(seed)
    chosen, facts = FORMS[form]
    net = chosen.network(facts)
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2.0)  # gates that open and close
    return net


@cache
def route_of(form: str, level: str) -> NetworkRoute:
    net = network(form)
    graph = network_step_graph("lstm", net.state_size, SCALING, net.write)
    arrays = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    return NetworkRoute(weights_of("lstm", arrays), level=needs(level))


STEPS = {name: TorchStep(network(name), SCALING) for name in FORMS}


@every_level
@pytest.mark.parametrize("form", HOLDING)
@settings(max_examples=50, deadline=None)
@given(history=commands, held=st.floats(0.0, 6.0))
def test_a_held_command_holds_the_angle_to_the_last_bit(
    form: str, level: str, history: list[float], held: float
) -> None:
    motion = np.array([*history, *[held] * ARRIVED])
    step, route = STEPS[form], route_of(form, level)
    _, state = step.run(step.initial_rule().state(np.zeros((1, 1)))[0], motion)
    first = step.advance(state[None], np.array([[held]]))
    later = step.advance(first[1], np.array([[held]]))
    np.testing.assert_array_equal(first[1], state[None])
    np.testing.assert_array_equal(later[0], first[0])
    angles, after = route.advance(np.full(step.state_size, 0.1), np.array([*motion, *[held] * 200]))
    assert np.ptp(angles[len(motion) :]) == 0.0
    np.testing.assert_array_equal(route.advance(after, np.array([held]))[1], after)


def test_without_the_gate_a_hold_drifts() -> None:
    state = np.full(network("without gate").state_size, 0.1)
    angles, _ = route_of("without gate", "plain").advance(state, np.full(200, 3.0))
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
@every_level
@every_form
def test_the_engine_is_exact_from_any_state(form: str, level: str) -> None:
    net, route = network(form).double(), route_of(form, level)
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


@pytest.mark.slow
def test_the_default_lstm_holds_in_its_file_and_behind_its_predictor() -> None:
    """onnxruntime and the engine, after a motion that was recorded: not a bit of drift in a minute."""
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
        weights_of("lstm", {GATED_MARK: np.zeros((1, 4))})
