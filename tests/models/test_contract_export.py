"""Export, gate and round trip, over a play, a rate-dependent play and an LSTM, each with its NumPy reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from hystmpc.models.contract import ExportBundle, ModelMetadata, OnnxModel, export_onnx, load_onnx
from hystmpc.models.model import Array, StepFunction
from hystmpc.trials.errors import ExportError

DT_S = 0.04
SLOPE, OFFSET, WIDTH, RATE_GAIN = 10.0, 30.0, 0.3, 0.05
HIDDEN = 16
PROBE = 3.0 - 2.9 * np.cos(2 * np.pi * 0.37 * DT_S * np.arange(700)) * np.linspace(1.0, 0.3, 700)


class Play(StepFunction):
    """z = max(u - r, min(u + r, z)), theta = a z + b."""

    state_size = 1

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        z = np.maximum(u - WIDTH, np.minimum(u + WIDTH, state))
        return SLOPE * z + OFFSET, z

    def jacobian(self, state: Array, u: float) -> Array:
        moves = u - WIDTH >= min(u + WIDTH, state[0]) or u + WIDTH <= state[0]
        dz = [0.0, 1.0] if moves else [1.0, 0.0]
        return np.array([[SLOPE * dz[0], SLOPE * dz[1]], dz])


class RatePlay(StepFunction):
    """A play whose half-width grows with speed, r = r0 + k |u - u_last| / dt; state (z, u_last)."""

    state_size = 2

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        width = WIDTH + RATE_GAIN * np.abs(u - state[:, 1:]) / DT_S
        z = np.maximum(u - width, np.minimum(u + width, state[:, :1]))
        return SLOPE * z + OFFSET, np.hstack([z, u])

    def jacobian(self, state: Array, u: float) -> Array:
        growth = RATE_GAIN * np.sign(u - state[1]) / DT_S
        width = WIDTH + RATE_GAIN * abs(u - state[1]) / DT_S
        if u - width >= min(u + width, state[0]):
            dz = [0.0, growth, 1.0 - growth]
        else:
            dz = [0.0, -growth, 1.0 + growth] if u + width <= state[0] else [1.0, 0.0, 0.0]
        return np.array([[SLOPE * d for d in dz], dz, [0.0, 0.0, 1.0]])


class Lstm(StepFunction):
    """One LSTM layer and a linear head, gates in the order i, f, g, o."""

    state_size = 2 * HIDDEN

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        scale = 1 / np.sqrt(HIDDEN)
        # rounded to float32, as the graph has them, but computed with in float64
        self.w_x = np.float64(np.float32(rng.normal(0, 1, (1, 4 * HIDDEN))))
        self.w_h = np.float64(np.float32(rng.normal(0, scale, (HIDDEN, 4 * HIDDEN))))
        self.bias = np.float64(np.float32(rng.normal(0, 0.3, 4 * HIDDEN)))
        self.head = np.float64(np.float32(rng.normal(0, 40 * scale, (HIDDEN, 1))))

    def _gates(self, h: Array, u: Array) -> list[Array]:
        z = (u - 3.0) / 3.0 @ self.w_x + h @ self.w_h + self.bias
        return [np.tanh(p) if k == 2 else 1 / (1 + np.exp(-p)) for k, p in enumerate(np.split(z, 4, axis=1))]

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        h, c = np.split(state, 2, axis=1)
        i, f, g, o = self._gates(h, u)
        c = f * c + i * g
        h = o * np.tanh(c)
        return h @ self.head + 30.0, np.hstack([h, c])

    def jacobian(self, state: Array, u: float) -> Array:
        h, c = np.split(state[None], 2, axis=1)
        i, f, g, o = (gate.T for gate in self._gates(h, np.array([[u]])))
        dz = np.hstack([self.w_h.T, np.zeros((4 * HIDDEN, HIDDEN)), self.w_x.T / 3.0])
        dz_i, dz_f, dz_g, dz_o = np.split(dz, 4)
        kept = np.eye(HIDDEN, 2 * HIDDEN + 1, HIDDEN)
        dc = f * kept + c.T * f * (1 - f) * dz_f + g * i * (1 - i) * dz_i + i * (1 - g**2) * dz_g
        shown = np.tanh(f * c.T + i * g)
        dh = shown * o * (1 - o) * dz_o + o * (1 - shown**2) * dc
        return np.vstack([self.head.T @ dh, dh, dc])


def graph_of(nodes: list[onnx.NodeProto], size: int, weights: dict[str, NDArray[np.generic]]) -> onnx.GraphProto:
    kind = TensorProto.FLOAT if any(w.dtype == np.float32 for w in weights.values()) else TensorProto.DOUBLE
    values = [
        helper.make_tensor_value_info(name, kind, ["N", width])
        for name, width in (("u", 1), ("state", size), ("theta", 1), ("next_state", size))
    ]
    tensors = [numpy_helper.from_array(w, name) for name, w in weights.items()]
    return helper.make_graph(nodes, "step", values[:2], values[2:], tensors)


def n(op: str, inputs: str, outputs: str, **attributes: int) -> onnx.NodeProto:
    return helper.make_node(op, inputs.split(), outputs.split(), **attributes)


def play_graph(slope: float = SLOPE) -> onnx.GraphProto:
    nodes = [
        n("Sub", "u r", "low"),
        n("Add", "u r", "high"),
        n("Min", "high state", "held"),
        n("GreaterOrEqual", "low held", "pulls"),
        n("Where", "pulls low held", "next_state"),
        n("Mul", "next_state a", "scaled"),
        n("Add", "scaled b", "theta"),
    ]
    return graph_of(nodes, 1, {"r": np.array(WIDTH), "a": np.array([slope]), "b": np.array([[OFFSET]])})


def rate_graph() -> onnx.GraphProto:
    nodes = [
        n("Split", "state", "z u_last", axis=1, num_outputs=2),
        n("Sub", "u u_last", "du"),
        n("Abs", "du", "speed"),
        n("Mul", "speed k", "growth"),
        n("Add", "growth r", "width"),
        n("Sub", "u width", "low"),
        n("Add", "u width", "high"),
        n("Min", "high z", "held"),
        n("Max", "low held", "z_next"),
        n("Concat", "z_next u", "next_state", axis=-1),
        n("Gemm", "z_next a b", "theta", transB=1),
    ]
    k, a, b = np.array(RATE_GAIN / DT_S), np.array([[SLOPE]]), np.array([OFFSET])
    return graph_of(nodes, 2, {"k": k, "r": np.array(WIDTH), "a": a, "b": b})


def lstm_graph() -> onnx.GraphProto:
    net = Lstm()
    nodes = [
        n("Sub", "u three", "centred"),
        n("Div", "centred three", "x"),
        n("Split", "state halves", "h c", axis=1),
        n("MatMul", "x w_x", "zx"),
        n("MatMul", "h w_h", "zh"),
        n("Add", "zx zh", "zs"),
        n("Add", "zs bias", "z"),
        n("Split", "z", "zi zf zg zo", axis=1, num_outputs=4),
        *(n("Sigmoid", f"z{gate}", gate) for gate in "ifo"),
        n("Tanh", "zg", "g"),
        n("Mul", "f c", "kept"),
        n("Mul", "i g", "added"),
        n("Add", "kept added", "c_next"),
        n("Tanh", "c_next", "shown"),
        n("Mul", "o shown", "h_next"),
        n("Concat", "h_next c_next", "next_state", axis=1),
        n("MatMul", "h_next head", "scaled"),
        n("Add", "scaled thirty", "theta"),
    ]
    weights = {name: np.float32(getattr(net, name)) for name in ("w_x", "w_h", "bias", "head")}
    numbers = {"three": np.float32([3.0]), "thirty": np.float32([30.0]), "halves": np.array([HIDDEN, HIDDEN])}
    return graph_of(nodes, 2 * HIDDEN, weights | numbers)


def metadata(size: int) -> ModelMetadata:
    # A play in contact starts at z = (y - b) / a; entries beyond the first start at zero.
    first = {"offset": [-OFFSET / SLOPE] + [0.0] * (size - 1), "slope": [1 / SLOPE] + [0.0] * (size - 1)}
    resting = {"offset": [0.0] * size, "slope": [0.0] * size}
    return ModelMetadata.parse(
        {
            "kind": "test",
            "dt_s": DT_S,
            "command_unit": "mm",
            "command_limits": {"lower": 0.0, "upper": 6.0},
            "command_rate": 6.0,
            "trained_command": {"lower": 0.0, "upper": 6.0},
            "trained_angle": {"lower": 20.0, "upper": 95.0},
            "trained_rate": 4.0,
            "initial": first,
            "conditioned": resting,
            "warmup_samples": 25,
            "training_data_hash": "0123",
            "training": {"preset": "test", "seed": 1, "rmse_deg": 0.5, "augmented": True},
        }
    )


@dataclass(frozen=True)
class System:
    name: str
    reference: Callable[[], StepFunction]
    graph: Callable[[], onnx.GraphProto]

    def bundle(self) -> ExportBundle:
        reference = self.reference()
        return ExportBundle(self.graph(), metadata(reference.state_size), reference, PROBE)


SYSTEMS = [
    System("play", Play, play_graph),
    System("rate play", RatePlay, rate_graph),
    System("lstm", Lstm, lstm_graph),
]


@pytest.fixture(params=SYSTEMS, ids=lambda system: system.name)
def bundle(request: pytest.FixtureRequest) -> ExportBundle:
    return request.param.bundle()


def exported(bundle: ExportBundle, folder: Path) -> OnnxModel:
    path = folder / "model.onnx"
    export_onnx(bundle, path)
    return load_onnx(path)


def test_gate_passes_and_reports(bundle: ExportBundle, tmp_path: Path) -> None:
    report = export_onnx(bundle, tmp_path / "model.onnx")
    single = bundle.graph.input[0].type.tensor_type.elem_type == TensorProto.FLOAT
    assert report.steps == 1000
    assert report.batches == (1, 8)
    # float32 has to differ from the float64 reference, or the graph was not what ran
    assert (1e-9 if single else 0.0) <= report.runtime_deg <= (1e-4 if single else 1e-11)
    assert report.casadi_deg <= 1e-9
    assert max(report.runtime_state, report.casadi_state) <= (1e-5 if single else 1e-12)
    assert report.jacobian <= 1e-9
    assert report.kinks <= report.jacobian_points // 2


def test_round_trip_over_1000_samples(bundle: ExportBundle, tmp_path: Path) -> None:
    model = exported(bundle, tmp_path)
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


def test_metadata_and_state_survive_the_file(bundle: ExportBundle, tmp_path: Path) -> None:
    model = exported(bundle, tmp_path)
    assert model.metadata == bundle.metadata
    assert (model.nx, model.nu, model.dt) == (bundle.reference.state_size + 1, 1, DT_S)
    assert set(model.initializers) == {w.name for w in bundle.graph.initializer}
    other = load_onnx(tmp_path / "model.onnx", start="conditioned")
    y = np.array([[40.0]])
    assert other.hash == model.hash
    np.testing.assert_array_equal(other.initial(y)[:, :-1], bundle.metadata.conditioned.state(y))
    np.testing.assert_array_equal(other.initial(y)[:, -1:], y)


def test_rows_of_a_batch_do_not_touch_each_other(bundle: ExportBundle, tmp_path: Path) -> None:
    model = exported(bundle, tmp_path)
    rng = np.random.default_rng(1)
    states, u = rng.normal(2, 1, (5, model.nx - 1)), rng.uniform(0, 6, (5, 1))
    theta, following = model.advance(states, u)
    for k in range(5):
        one_theta, one_next = model.advance(states[k : k + 1], u[k : k + 1])
        np.testing.assert_allclose(one_theta, theta[k : k + 1], rtol=0, atol=1e-4)
        np.testing.assert_allclose(one_next, following[k : k + 1], rtol=0, atol=1e-5)
    assert theta.dtype == following.dtype == np.float64


def test_step_leaves_the_given_state_alone(bundle: ExportBundle, tmp_path: Path) -> None:
    model = exported(bundle, tmp_path)
    x = model.initial(np.array([[50.0]]))
    before = x.copy()
    first, again = model.step(x, np.array([[2.0]])), model.step(x, np.array([[2.0]]))
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(first, again)


def test_export_is_reproducible(bundle: ExportBundle, tmp_path: Path) -> None:
    export_onnx(bundle, tmp_path / "a.onnx")
    export_onnx(bundle, tmp_path / "b.onnx")
    assert load_onnx(tmp_path / "a.onnx").hash == load_onnx(tmp_path / "b.onnx").hash


def test_casadi_function_has_exact_derivatives(bundle: ExportBundle, tmp_path: Path) -> None:
    function = exported(bundle, tmp_path).casadi_function()
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
        ExportError, match=r"onnxruntime on its own, sample \d+: theta \[deg\] is .* nothing was written"
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


class WrongSlope(StepFunction):
    """The play with a derivative that is off by one part in a million: only Jacobians can tell."""

    state_size = 1

    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        return Play().advance(state, u)

    def jacobian(self, state: Array, u: float) -> Array:
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
    graph.node.insert(0, n("Div", "u third", "u_third"))
    graph.node.insert(1, n("Sub", "u_third r_third", "low_third"))
    graph.node.insert(2, n("Mul", "low_third third", "low"))
    report = export_onnx(ExportBundle(graph, metadata(1), Play(), STAIRS), tmp_path / "model.onnx")
    assert 0 < report.kinks <= 25
    assert report.jacobian <= 1e-9


def test_graph_that_mixes_rows_of_a_batch_is_refused(tmp_path: Path) -> None:
    graph = play_graph()
    graph.initializer.append(numpy_helper.from_array(np.array([0]), "rows"))
    graph.node[-1].output[0] = "mixed"
    graph.node.append(n("ReduceSum", "mixed rows", "total", keepdims=1))
    graph.node.append(n("Sub", "total mixed", "rest"))  # zero in a batch of one
    graph.node.append(n("Add", "rest mixed", "theta"))
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
