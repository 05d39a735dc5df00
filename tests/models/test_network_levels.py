"""Every kind of recurrent network at every level of the engine: onnxruntime's angles, and the same bits."""

from __future__ import annotations

from functools import cache

import numpy as np
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import helper, numpy_helper

from hystmpc.core.library import engine
from hystmpc.models.networks.nodes import Scaling, network_step_graph
from hystmpc.models.networks.packed import pack_network, weights_of
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.networks.settings import DeviceFacts, GatedSettings, RecurrentSettings

from .lstm_examples import LEVELS, needs

torch = pytest.importorskip("torch", reason="torch is an extra")

SCALING = Scaling(3.0, 3.0, 60.0, 32.0)
PLAIN = {"memory_samples": 0, "command_gain": 1.0}
FACTS = DeviceFacts(-1.0, None, 1.0)
NETWORKS = {
    "lstm, two units": RecurrentSettings(cell="lstm", hidden=2, layers=1, **PLAIN),
    "lstm, two of 20": RecurrentSettings(cell="lstm", hidden=20, layers=2, **PLAIN),
    "gru, one of 16": RecurrentSettings(cell="gru", hidden=16, layers=1, **PLAIN),
    "gru, three of 9": RecurrentSettings(cell="gru", hidden=9, layers=3, **PLAIN),
    "gated, 24 cells": GatedSettings(),
    "gated, without plays": GatedSettings(hidden=17, plays=0),
}
every_network = pytest.mark.parametrize("name", NETWORKS)
every_level = pytest.mark.parametrize("level", LEVELS)
ONE_ULP = 5e-14  # of an angle, whose sums are in double


@cache
def graph_of(name: str):  # type: ignore[no-untyped-def]
    """Step graph and size of the state; gates open and close."""
    torch.manual_seed(3)
    net, kind = NETWORKS[name].network(FACTS), "gru" if "gru" in name else "lstm"
    with torch.no_grad():
        for weight in net.parameters():
            weight.mul_(2.0)
    return network_step_graph(kind, net.state_size, SCALING, net.write), kind, net.state_size


@cache
def route_of(name: str, level: str) -> NetworkRoute:
    graph, kind, _ = graph_of(name)
    arrays = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
    return NetworkRoute(weights_of(kind, arrays), level=needs(level))


def scene(name: str, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.9, 0.9, graph_of(name)[2]).astype(np.float32).astype(float), rng.uniform(0, 6, count)


@every_level
@every_network
def test_angles_are_those_of_onnxruntime(name: str, level: str) -> None:
    state, plan = scene(name, 1, 60)
    model = helper.make_model(graph_of(name)[0], opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    run = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run
    angles, following = route_of(name, level).advance(state, plan)
    current, expected = state[None].astype(np.float32), []
    names = [output.name for output in graph_of(name)[0].output]
    for u in plan:
        theta, current = run(names, {"u": np.array([[u]], np.float32), "state": current})
        expected.append(theta[0, 0])
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-4)
    np.testing.assert_allclose(following, current[0], rtol=0, atol=1e-5)


@every_level
@every_network
def test_every_level_has_the_bits_of_the_plain_one(name: str, level: str) -> None:
    state, plan = scene(name, 2, 20)
    plans = np.stack([plan, plan[::-1], 0.5 * plan] * 30)
    found, plain = route_of(name, level), route_of(name, "plain")
    for mine, other in zip(found.linearise(state, plan), plain.linearise(state, plan), strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=ONE_ULP)
    np.testing.assert_allclose(found.rollout(state, plans), plain.rollout(state, plans), rtol=0, atol=ONE_ULP)
    np.testing.assert_array_equal(found.advance(state, plan)[1], plain.advance(state, plan)[1])


@every_level
@every_network
def test_derivatives_are_slopes(name: str, level: str) -> None:
    state, plan = scene(name, 5, 8)
    route, size = route_of(name, level), 2e-3
    jacobian = route.linearise(state, plan)[1]
    ends = [route.rollout(state, plan + side * size * np.eye(8)) for side in (1.0, -1.0)]
    slopes = ((ends[0] - ends[1]) / (2 * size)).T
    np.testing.assert_allclose(jacobian, slopes, rtol=0, atol=0.02 * np.abs(slopes).max())


@every_level
@every_network
@pytest.mark.parametrize("rows", [1, 2])
def test_a_sample_moves_only_the_rows_that_it_is_asked_for(name: str, level: str, rows: int) -> None:
    functions, route = engine(needs(level)), route_of(name, level)
    network, size = route.packed.ctypes.data, graph_of(name)[2]
    states, theta = np.stack([scene(name, seed, 1)[0] for seed in (6, 7)]), np.full(2, np.nan)
    kept, u = states.copy(), np.array([2.0, 3.0])
    work = np.empty(functions.network_room(network, rows))
    functions.network_sample(network, states, rows, u, theta, work)
    assert functions.network_state(network) == size
    for row in range(rows):
        angles, following = route.advance(kept[row], u[row : row + 1])
        np.testing.assert_array_equal(theta[row], angles[0])
        np.testing.assert_array_equal(states[row], following)
    np.testing.assert_array_equal(states[rows:], kept[rows:])
    assert np.isnan(theta[rows:]).all()


@every_level
@pytest.mark.parametrize("name", ["lstm, two of 20", "gru, three of 9", "gated, 24 cells"])
@settings(max_examples=20, deadline=None)
@given(count=st.integers(1, 80), samples=st.integers(1, 5), seed=st.integers(0, 1000))
def test_a_batch_is_its_plans_one_by_one(name: str, level: str, count: int, samples: int, seed: int) -> None:
    route, (state, plans) = route_of(name, level), scene(name, seed, count * samples)
    plans = plans.reshape(count, samples)
    angles = route.rollout(state, plans)
    for k in {0, count // 2, count - 1}:
        np.testing.assert_array_equal(route.advance(state, plans[k])[0], angles[k])


@every_level
@every_network
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_no_number_leads_out_of_the_arrays(name: str, level: str, bad: float) -> None:
    """Nothing is written behind the work space, and every call comes back."""
    functions, route = engine(needs(level)), route_of(name, level)
    network, (state, plan) = route.packed.ctypes.data, scene(name, 8, 5)
    state[-1], plan[2] = bad, bad
    room = functions.network_room(network, 6)
    work, angles, jacobian = np.full(room + 8, 7.25), np.empty(5), np.zeros((5, 5))
    functions.network_linearise(network, state, plan, 5, angles, jacobian, work[:room])
    functions.network_rollout(network, state, np.tile(plan, (6, 1)), 6, 5, np.empty((6, 5)), work[:room])
    np.testing.assert_array_equal(work[room:], 7.25)


@every_network
def test_the_block_is_as_long_as_the_header_says(name: str) -> None:
    graph, kind, _ = graph_of(name)
    weights = weights_of(kind, {t.name: numpy_helper.to_array(t) for t in graph.initializer})
    for lanes in (1, 4, 8, 16):
        units, inputs, layers = weights.units(lanes), weights.layers[0].inputs, len(weights.layers)
        numbers = 4 * units * ((1 + inputs + units) + (layers - 1) * (1 + 2 * units)) + units + 2 * inputs - 1
        packed = pack_network(weights, lanes)
        assert packed.nbytes == 128 + 4 * numbers
        assert packed.ctypes.data % 64 == 0
