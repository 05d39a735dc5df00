"""One LSTM, many ways to run it: NumPy, PyTorch, the ONNX graph, the engine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.contract.metadata import ModelMetadata, Start
from hystmpc.models.motions import probe_commands
from hystmpc.models.networks.lstm import LstmLayer, LstmWeights
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.networks.packed import lstm_weights
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.prediction.exported import RoutedPredictor, recurrent_predictor
from hystmpc.trials.errors import ModelError
from hystmpc_lab.performance.lstm_reference import LstmStep, lstm_step_graph

from .lstm_examples import LEVELS, SIZES, facts, make_route, random_weights

EXAMPLES = {name: random_weights(*size) for name, size in SIZES.items()}
every_size = pytest.mark.parametrize("weights", EXAMPLES.values(), ids=EXAMPLES.keys())
every_level = pytest.mark.parametrize("level", LEVELS)
STEPS = 1000
FREE_RUN_DEG = 1e-3


def commands(count: int = STEPS) -> np.ndarray:
    t = 0.04 * np.arange(count)
    return 3 - 2 * np.cos(2 * np.pi * 0.3 * t) + 0.9 * np.sin(2 * np.pi * 0.07 * t)


def reference_run(weights: LstmWeights, u: np.ndarray, state: np.ndarray | None = None) -> np.ndarray:
    step, angles = LstmStep(weights), []
    state = np.zeros((1, weights.state_size)) if state is None else state[None]
    for value in u:
        theta, state = step.advance(state, np.array([[value]]))
        angles.append(theta[0, 0])
    return np.array(angles)


def some_state(weights: LstmWeights, seed: int = 3) -> np.ndarray:
    """A state that a motion leads to, the numbers in single precision."""
    step, state = LstmStep(weights), np.zeros((1, weights.state_size))
    for u in np.random.default_rng(seed).uniform(0, 6, 30):
        _, state = step.advance(state, np.array([[u]]))
    return state[0].astype(np.float32).astype(float)


def predictor_of(weights: LstmWeights, level: str) -> RoutedPredictor:
    return RoutedPredictor(facts(weights), "conditioned", make_route(weights, level))


def best(metadata: ModelMetadata, weights: LstmWeights, start: Start = "conditioned") -> RoutedPredictor:
    return RoutedPredictor(metadata, start, NetworkRoute(lstm_weights(weights)))


def test_paper_size_has_the_papers_number_of_parameters() -> None:
    assert EXAMPLES["two of 64"].parameter_count == 50_497


@every_size
def test_torch_agrees_over_a_long_run(weights: LstmWeights) -> None:
    torch = pytest.importorskip("torch")
    from hystmpc.models.networks.network_ import numbers
    from hystmpc.models.networks.recurrent_ import lstm_layers
    from hystmpc_lab.performance.peers_ import net_of

    net, scaling, u = net_of(weights), weights.scaling, commands()
    with torch.no_grad():
        v = torch.tensor(scaling.scale_in(u), dtype=torch.float32)[None]
        y, _ = net(v, net.start(v[:, 0]))
    theta = scaling.theta_offset + scaling.theta_scale * y[0].double().numpy()
    np.testing.assert_allclose(theta, reference_run(weights, u), rtol=0, atol=FREE_RUN_DEG)
    back = LstmWeights(
        lstm_layers(net), numbers(net.head.weight)[0], float(numbers(net.head.bias)[0]), scaling
    ).to_arrays()
    for name, array in weights.to_arrays().items():
        np.testing.assert_array_equal(back[name], array, err_msg=name)


@pytest.mark.slow
@every_size
def test_exported_file_passes_the_gate_and_feeds_the_kernels(weights: LstmWeights, tmp_path: Path) -> None:
    metadata = facts(weights)
    bundle = ExportBundle(lstm_step_graph(weights), metadata, LstmStep(weights), probe_commands(metadata))
    report = export_onnx(bundle, tmp_path / "lstm.onnx")
    assert report.runtime_deg < FREE_RUN_DEG
    assert report.casadi_deg < FREE_RUN_DEG
    model = load_onnx(tmp_path / "lstm.onnx")
    again = LstmWeights.from_arrays(model.initializers).to_arrays()
    for name, array in weights.to_arrays().items():
        np.testing.assert_array_equal(again[name], array, err_msg=name)
    from_file, direct = (
        recurrent_predictor(model),
        best(metadata, weights),
    )
    start = direct.initial(45.0, 1.0)
    np.testing.assert_array_equal(from_file.initial(45.0, 1.0), start)
    plans = commands(40).reshape(4, 10)
    np.testing.assert_array_equal(from_file.rollout(start, plans), direct.rollout(start, plans))


@every_level
@every_size
def test_compiled_step_agrees_over_a_long_run(weights: LstmWeights, level: str) -> None:
    predictor, u = predictor_of(weights, level), commands()
    state, angles = np.zeros(weights.state_size), []
    for value in u:
        theta, state = predictor.advance(state, value)
        angles.append(theta)
    np.testing.assert_allclose(angles, reference_run(weights, u), rtol=0, atol=FREE_RUN_DEG)


@every_level
@every_size
@pytest.mark.parametrize("count", [1, 3, 64, 65, 200])
def test_rollout_is_repeated_steps_for_any_number_of_plans(weights: LstmWeights, count: int, level: str) -> None:
    predictor, state = predictor_of(weights, level), some_state(weights)
    plans = np.random.default_rng(count).uniform(0, 6, (count, 12))
    theta = predictor.rollout(state, plans)
    assert theta.shape == plans.shape
    for k in {0, count // 2, count - 1}:
        current, stepped = state, []
        for u in plans[k]:
            angle, current = predictor.advance(current, u)
            stepped.append(angle)
        np.testing.assert_allclose(theta[k], stepped, rtol=0, atol=2e-4)
        np.testing.assert_allclose(theta[k], predictor.rollout(state, plans[k : k + 1])[0], rtol=0, atol=2e-4)


@every_size
def test_reference_jacobian_is_the_slope_of_the_step(weights: LstmWeights) -> None:
    step, point = LstmStep(weights), np.append(some_state(weights), 2.5)

    def at(values: np.ndarray) -> np.ndarray:
        return np.hstack(step.advance(values[None, :-1], values[None, -1:]))[0]

    nudges = 1e-6 * np.eye(point.size)
    slope = np.stack([(at(point + d) - at(point - d)) / 2e-6 for d in nudges], axis=1)
    np.testing.assert_allclose(step.jacobian(point[:-1], 2.5), slope, rtol=1e-6, atol=1e-7)


@every_level
@every_size
@pytest.mark.parametrize("horizon", [1, 2, 13, 30])
def test_compiled_jacobian_is_the_chain_of_reference_jacobians(weights: LstmWeights, horizon: int, level: str) -> None:
    predictor, step, state = predictor_of(weights, level), LstmStep(weights), some_state(weights)
    plan = np.random.default_rng(horizon).uniform(0, 6, horizon)
    theta, jacobian = predictor.linearise(state, plan)
    expected, tangents, current = np.zeros((horizon, horizon)), np.zeros((state.size, horizon)), state
    for k, u in enumerate(plan):
        local = step.jacobian(current, u)
        inner = np.vstack([tangents, np.eye(horizon)[k]])
        expected[k], tangents = local[0] @ inner, local[1:] @ inner
        current = step.advance(current[None], np.array([[u]]))[1][0]
    np.testing.assert_allclose(theta, reference_run(weights, plan, state), rtol=0, atol=FREE_RUN_DEG)
    np.testing.assert_allclose(jacobian, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    assert np.array_equal(jacobian, np.tril(jacobian))


@every_level
@settings(max_examples=30, deadline=None)
@given(u=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=25), seed=st.integers(0, 100))
def test_any_finite_plan_gives_finite_predictions_and_leaves_the_state_alone(
    level: str, u: list[float], seed: int
) -> None:
    weights = EXAMPLES["one layer of 5"]
    predictor, state = predictor_of(weights, level), some_state(weights, seed)
    before = state.copy()
    theta, jacobian = predictor.linearise(state, np.array(u))
    assert np.isfinite(theta).all()
    assert np.isfinite(jacobian).all()
    np.testing.assert_allclose(predictor.rollout(state, np.array([u]))[0], theta, rtol=0, atol=1e-3)
    np.testing.assert_array_equal(state, before)


def test_start_follows_the_rule_and_the_warm_up() -> None:
    weights = EXAMPLES["three of 7"]
    metadata = facts(weights, warmup=4)
    for start in ("initial", "conditioned"):
        predictor = best(metadata, weights, start)
        state = np.array(getattr(metadata, start).offset)
        for _ in range(4):
            _, state = predictor.advance(state, 1.5)
        np.testing.assert_array_equal(predictor.initial(40.0, 1.5), state)


def test_wrong_sizes_are_refused() -> None:
    good = EXAMPLES["three of 7"]
    with pytest.raises(ModelError, match=r"expected \[\(1, 7\), \(7, 7\)\]"):
        LstmWeights((good.layers[1], good.layers[2]), good.head_weight, 0.0)
    with pytest.raises(ModelError, match="head \\(3,\\)"):
        LstmWeights(good.layers, np.zeros(3), 0.0)
    with pytest.raises(ModelError, match="no layer"):
        LstmWeights((), np.zeros(3), 0.0)
    with pytest.raises(ModelError, match="bias \\(27,\\)"):
        LstmLayer(good.layers[0].w_ih, good.layers[0].w_hh, np.zeros(27))
    with pytest.raises(ModelError, match="not finite"):
        LstmWeights(good.layers, good.head_weight * np.nan, 0.0)
    with pytest.raises(ModelError, match="scales > 0"):
        Scaling(u_scale=0.0)
    arrays = good.to_arrays()
    del arrays["lstm.1.w_hh"]
    with pytest.raises(ModelError, match=r"no array lstm\.1\.w_hh"):
        LstmWeights.from_arrays(arrays)
