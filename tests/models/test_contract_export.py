"""Export, gate and round trip, over a play, a rate-dependent play and an LSTM, each with its NumPy reference."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import onnx
import pytest
from onnx import TensorProto, numpy_helper

from hystmpc.models.contract.export import EquivalenceReport, ExportBundle, export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.model import StepFunction
from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Vec

from .contract_examples import DT_S, PROBE, SLOPE, SYSTEMS, WIDTH, Play, RatePlay, graph_of, metadata, node, play_graph


@pytest.fixture(scope="module", params=SYSTEMS, ids=lambda system: system.name)
def bundle(request: pytest.FixtureRequest) -> ExportBundle:
    return request.param.bundle()


@pytest.fixture(scope="module")
def exported(bundle: ExportBundle, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, EquivalenceReport]:
    path = tmp_path_factory.mktemp("exported") / "model.onnx"
    return path, export_onnx(bundle, path)


@pytest.fixture
def model(exported: tuple[Path, EquivalenceReport]) -> OnnxModel:
    return load_onnx(exported[0])


def test_gate_passes_and_reports(bundle: ExportBundle, exported: tuple[Path, EquivalenceReport]) -> None:
    report = exported[1]
    single = bundle.graph.input[0].type.tensor_type.elem_type == TensorProto.FLOAT
    assert report.steps == 1000
    assert report.batches == (1, 8)
    # float32 has to differ from the float64 reference, or the graph was not what ran
    assert (1e-9 if single else 0.0) <= report.runtime_deg <= (1e-4 if single else 1e-11)
    assert report.casadi_deg <= 1e-9
    assert max(report.runtime_state, report.casadi_state) <= (1e-5 if single else 1e-12)
    assert report.jacobian <= 1e-9
    assert report.kinks <= report.jacobian_points // 2


def test_round_trip_over_1000_samples(bundle: ExportBundle, model: OnnxModel) -> None:
    y = np.array([[35.0], [60.0], [81.0]])
    x, state = model.initial(y), bundle.metadata.initial.state(y)
    np.testing.assert_array_equal(model.output(x), y)
    worst = 0.0
    for k in range(1000):
        u = np.full((3, 1), PROBE[k % PROBE.size]) * [[1.0], [0.7], [0.2]]
        x = model.step(x, u)
        theta, state = bundle.reference.advance(state, u)
        worst = max(worst, float(np.abs(model.output(x) - theta).max()))
    assert worst <= 1e-3


def test_metadata_and_state_survive_the_file(
    bundle: ExportBundle, model: OnnxModel, exported: tuple[Path, EquivalenceReport]
) -> None:
    assert model.metadata == bundle.metadata
    assert (model.nx, model.nu, model.dt) == (bundle.reference.state_size + 1, 1, DT_S)
    assert set(model.initializers) == {w.name for w in bundle.graph.initializer}
    other = load_onnx(exported[0], start="conditioned")
    y = np.array([[40.0]])
    assert other.hash == model.hash
    np.testing.assert_array_equal(other.initial(y)[:, :-1], bundle.metadata.conditioned.state(y))
    np.testing.assert_array_equal(other.initial(y)[:, -1:], y)


def test_rows_of_a_batch_do_not_touch_each_other(model: OnnxModel) -> None:
    rng = np.random.default_rng(1)
    states, u = rng.normal(2, 1, (5, model.nx - 1)), rng.uniform(0, 6, (5, 1))
    theta, following = model.advance(states, u)
    for k in range(5):
        one_theta, one_next = model.advance(states[k : k + 1], u[k : k + 1])
        np.testing.assert_allclose(one_theta, theta[k : k + 1], rtol=0, atol=1e-4)
        np.testing.assert_allclose(one_next, following[k : k + 1], rtol=0, atol=1e-5)
    assert theta.dtype == following.dtype == np.float64


def test_step_leaves_the_given_state_alone(model: OnnxModel) -> None:
    x = model.initial(np.array([[50.0]]))
    before = x.copy()
    first, again = model.step(x, np.array([[2.0]])), model.step(x, np.array([[2.0]]))
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(first, again)


def test_export_is_reproducible(bundle: ExportBundle, model: OnnxModel, tmp_path: Path) -> None:
    export_onnx(bundle, tmp_path / "again.onnx")
    assert load_onnx(tmp_path / "again.onnx").hash == model.hash


def test_casadi_function_has_exact_derivatives(bundle: ExportBundle, model: OnnxModel) -> None:
    function = model.casadi_function()
    size = bundle.reference.state_size
    x, u = ca.MX.sym("x", size), ca.MX.sym("u")
    jacobian = ca.Function("j", [x, u], [ca.jacobian(ca.vertcat(*function(x, u)), ca.vertcat(x, u))])
    rng = np.random.default_rng(5)
    for _ in range(10):
        point = np.append(rng.normal(2, 1, size), rng.uniform(0, 6))
        exact = np.array(jacobian(point[:-1], point[-1]))
        np.testing.assert_allclose(exact, bundle.reference.jacobian(point[:-1], point[-1]), rtol=1e-9, atol=1e-9)
        h = 1e-6
        for j, nudge in enumerate(h * np.eye(size + 1)):
            ahead, behind = ((point + s * nudge) for s in (1, -1))
            difference = ca.vertcat(*function(ahead[:-1], ahead[-1])) - ca.vertcat(*function(behind[:-1], behind[-1]))
            np.testing.assert_allclose(exact[:, j], np.array(difference)[:, 0] / (2 * h), rtol=1e-6, atol=1e-6)


def test_changed_weight_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    wrong = ExportBundle(play_graph(slope=SLOPE * 1.001), metadata(1), Play(), PROBE)
    with pytest.raises(
        ExportError, match=r"onnxruntime in batches of 8, draw \d+, row \d: theta \[deg\] is .* nothing was written"
    ):
        export_onnx(wrong, tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []


def test_refused_export_keeps_the_file_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    export_onnx(SYSTEMS[0].bundle(), path)
    before = load_onnx(path).hash
    with pytest.raises(ExportError):
        export_onnx(ExportBundle(play_graph(slope=2.0), metadata(1), Play(), PROBE), path)
    assert load_onnx(path).hash == before


class Chaos(StepFunction):
    """x+ = 1 - 1.9 x^2, theta = x+: a difference in the last digit grows to the full range within a hundred steps."""

    state_size = 1

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        following = 1.0 - 1.9 * state * state + 0.0 * u
        return following, following

    def jacobian(self, state: Vec, _u: float) -> Vec:
        return np.array([[-3.8 * state[0], 0.0], [-3.8 * state[0], 0.0]])


def chaos_graph() -> onnx.GraphProto:
    """The same map, multiplied in another order."""
    nodes = [
        node("Mul", "state state", "square"),
        node("Mul", "square a", "scaled"),
        node("Sub", "one scaled", "mapped"),
        node("Mul", "u zero", "nothing"),
        node("Add", "mapped nothing", "next_state"),
        node("Identity", "next_state", "theta"),
    ]
    return graph_of(nodes, 1, {"a": np.array(1.9), "one": np.array(1.0), "zero": np.array(0.0)})


def test_sensitive_model_is_told_from_a_wrong_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    told = r"onnxruntime on its own, sample \d+: .* single steps agree to \S+e-1\d .* the model itself is sensitive"
    with pytest.raises(ExportError, match=told):
        export_onnx(ExportBundle(chaos_graph(), metadata(1), Chaos(), PROBE), "model.onnx")
    assert list(tmp_path.iterdir()) == []


class WrongSlope(StepFunction):
    """The play with a derivative that is off by one part in a million: only Jacobians can tell."""

    state_size = 1

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        return Play().advance(state, u)

    def jacobian(self, state: Vec, u: float) -> Vec:
        return Play().jacobian(state, u) * (1 + 1e-6)


def test_wrong_jacobian_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"CasADi Jacobian at sample \d+: entry"):
        export_onnx(ExportBundle(play_graph(), metadata(1), WrongSlope(), PROBE), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []


STAIRS = np.repeat([0.4, 1.3, 2.1, 3.4, 4.2, 5.3], 60) + np.tile(np.minimum(np.arange(60), 15) / 40, 6)


def test_other_branch_at_a_tie_is_refused_where_the_probe_rests(tmp_path: Path) -> None:
    graph = play_graph()
    graph.node[3].op_type = "Greater"  # GreaterOrEqual: a play in contact moves with the command
    path = tmp_path / "model.onnx"
    assert export_onnx(ExportBundle(play_graph(), metadata(1), Play(), STAIRS), path).kinks == 0
    path.unlink()
    with pytest.raises(ExportError, match="Jacobians differ from the reference on kinks, expected at most half"):
        export_onnx(ExportBundle(graph, metadata(1), Play(), STAIRS), path)
    assert list(tmp_path.iterdir()) == []


def test_rounding_at_a_tie_counts_as_a_kink_and_passes(tmp_path: Path) -> None:
    """The same play in thirds of a millimetre: in contact, rounding alone decides between two equal branches."""
    graph = play_graph()
    graph.initializer.append(numpy_helper.from_array(np.array(3.0), "third"))
    graph.initializer.append(numpy_helper.from_array(np.array(WIDTH / 3.0), "r_third"))
    del graph.node[0]
    graph.node.insert(0, node("Div", "u third", "u_third"))
    graph.node.insert(1, node("Sub", "u_third r_third", "low_third"))
    graph.node.insert(2, node("Mul", "low_third third", "low"))
    report = export_onnx(ExportBundle(graph, metadata(1), Play(), STAIRS), tmp_path / "model.onnx")
    assert 0 < report.kinks <= 25
    assert report.jacobian <= 1e-9


def test_graph_that_mixes_rows_of_a_batch_is_refused(tmp_path: Path) -> None:
    graph = play_graph()
    graph.initializer.append(numpy_helper.from_array(np.array([0]), "rows"))
    graph.node[-1].output[0] = "mixed"
    graph.node.append(node("ReduceSum", "mixed rows", "total", keepdims=1))
    graph.node.append(node("Sub", "total mixed", "rest"))  # zero in a batch of one
    graph.node.append(node("Add", "rest mixed", "theta"))
    with pytest.raises(ExportError, match="onnxruntime in batches of 8"):
        export_onnx(ExportBundle(graph, metadata(1), Play(), PROBE), tmp_path / "model.onnx")


def test_probe_outside_the_trained_range_is_refused() -> None:
    with pytest.raises(ExportError, match=r"probe is 6\.5 mm at sample 1, expected the trained range 0 to 6"):
        ExportBundle(play_graph(), metadata(1), Play(), np.array([1.0, 6.5]))


def test_state_sizes_have_to_match(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="reference has 1 state entries, metadata 2"):
        ExportBundle(play_graph(), metadata(2), Play(), PROBE)
    with pytest.raises(ExportError, match=r"inputs are 'state' float64 \[N,1\].*expected 'state' float64 \[N,2\]"):
        export_onnx(ExportBundle(play_graph(), metadata(2), RatePlay(), PROBE), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []


def test_trained_range_contains() -> None:
    trained = metadata(1).trained_command
    inside = trained.contains(np.array([-0.01, 0.0, 3.0, 6.0, 6.01, np.nan]))
    assert inside.tolist() == [False, True, True, True, False, False]
