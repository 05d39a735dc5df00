"""The graph interpreter: every operator against onnxruntime, derivatives, and use in a user's own problem."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.capi.onnxruntime_pybind11_state import NotImplemented as NotImplemented_

from hystmpc.models.contract.casadi_ import ALLOWED, to_casadi
from hystmpc.models.contract.load import IR_VERSION, OPSET
from hystmpc.trials.errors import ModelError

from .test_backends import one_thread

SIZE = 4
FLOAT, DOUBLE, BOOL, INT64 = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.BOOL, TensorProto.INT64
WEIGHTS = {
    "w": np.random.default_rng(0).normal(size=(SIZE, SIZE)),
    "b": np.array([0.5, -1.0, 0.0, 2.0]),
    "half": np.array(0.5),
    "column": np.array([[0.3], [1.0]]),
    "to_row": np.array([1, SIZE]),
    "to_square": np.array([0, 2, -1]),
    "by_three": np.array([3, 1]),
    "back": np.array([3, 1, 0, 2]),
    "one": np.array([1]),
    "both": np.array([0, 1]),
    "last": np.array([-1]),
    "minus": np.array([-1]),
    "far": np.array([-9]),
    "one_three": np.array([1, 3]),
    "three": np.array([3]),
}


def n(op: str, inputs: str, outputs: str, **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(op, inputs.split(), outputs.split(), **attributes)


def unary(op: str, start: str = "state") -> list[onnx.NodeProto]:
    return [n("Mul", "state state", "square"), n("Add", "square half", "positive"), n(op, start, "y")]


def logic(op: str, inputs: str) -> list[onnx.NodeProto]:
    flags = [n("Less", "state b", "less"), n("Greater", "state half", "more")]
    return [*flags, n(op, inputs, "flag"), n("Where", "flag state b", "y")]


def compare(op: str) -> list[onnx.NodeProto]:
    return [n(op, "state b", "flag"), n("Cast", "flag", "y", to=DOUBLE)]


# Each list ends in y, [1, SIZE] or of another shape that is flattened before it is compared.
CASES: dict[str, list[tuple[str, list[onnx.NodeProto]]]] = {
    **{op: [("", unary(op))] for op in ("Abs", "Ceil", "Cos", "Exp", "Floor", "Identity", "Neg", "Relu", "Sigmoid")},
    **{op: [("", unary(op))] for op in ("Sign", "Sin", "Softplus", "Tanh", "Erf")},
    **{op: [("", unary(op, "positive"))] for op in ("Log", "Reciprocal", "Sqrt")},
    **{op: [("", [n(op, "state b", "y")]), ("u", [n(op, "u b", "y")])] for op in ("Add", "Mul", "Sub")},
    **{op: [("", [n(op, "state b u", "y")]), ("one", [n(op, "state", "y")])] for op in ("Max", "Min")},
    **{op: [("", compare(op))] for op in ("Less", "LessOrEqual", "Greater", "GreaterOrEqual")},
    "Equal": [("", [n("Sign", "state", "s"), n("Equal", "s half", "flag"), n("Where", "flag b state", "y")])],
    "And": [("", logic("And", "less more"))],
    "Or": [("", logic("Or", "less more"))],
    "Not": [("", logic("Not", "less"))],
    "Where": [
        ("", [n("Less", "state half", "flag"), n("Where", "flag state b", "y")]),
        ("scalar", [n("Greater", "u half", "flag"), n("Where", "flag state b", "y")]),
    ],
    "Cast": [("", [n("Cast", "state", "i", to=INT64), n("Cast", "i", "y", to=DOUBLE)]), ("bool", compare("Less"))],
    "Clip": [
        ("", [n("Neg", "half", "low"), n("Clip", "state low half", "y")]),
        ("upper", [helper.make_node("Clip", ["state", "", "half"], ["y"])]),
    ],
    "Div": [("", [n("Add", "half u", "d"), n("Div", "state d", "y")])],
    "Pow": [
        (
            "square",
            [n("Constant", "", "two", value_float=2.0), n("Cast", "two", "p", to=DOUBLE), n("Pow", "state p", "y")],
        ),
        ("base", [n("Pow", "half state", "y")]),
    ],
    "Concat": [("", [n("Concat", "u state u", "y", axis=-1)])],
    "Expand": [("", [n("Expand", "u to_row", "y")]), ("column", [n("Expand", "state by_three", "y")])],
    "Gather": [("", [n("Gather", "state back", "y", axis=1)]), ("weights", [n("Gather", "w one", "y")])],
    "Reshape": [("", [n("Reshape", "state to_square", "y")])],
    "Slice": [
        ("", [n("Slice", "state one three last", "y")]),
        ("backwards", [n("Slice", "state minus far last minus", "y")]),
        ("first axis", [n("Slice", "w one three", "m"), n("Add", "m state", "y")]),
    ],
    "Split": [
        ("sizes", [n("Split", "state one_three", "a c", axis=1), n("Mul", "a c", "y")]),
        (
            "uneven",
            [
                n("Concat", "state u", "five", axis=1),
                n("Split", "five", "a c", axis=-1, num_outputs=2),
                n("Concat", "c a", "y", axis=1),
            ],
        ),
    ],
    "Squeeze": [("", [n("Squeeze", "u last", "s"), n("Add", "s b", "y")]), ("all", [n("Squeeze", "u", "y")])],
    "Unsqueeze": [("", [n("Unsqueeze", "state both", "y")])],
    "Transpose": [
        ("", [n("Reshape", "state to_square", "q"), n("Transpose", "q", "y", perm=[0, 2, 1])]),
        ("weights", [n("Transpose", "w", "t"), n("MatMul", "state t", "y")]),
    ],
    "MatMul": [
        ("", [n("MatMul", "state w", "y")]),
        ("vector", [n("MatMul", "state b", "y")]),
        ("left", [n("Transpose", "state", "s", perm=[1, 0]), n("MatMul", "w s", "y")]),
        ("three axes", [n("Unsqueeze", "state one", "s"), n("MatMul", "s w", "y")]),
        ("outer", [n("Transpose", "state", "s", perm=[1, 0]), n("MatMul", "s state", "y")]),
    ],
    "Gemm": [
        ("", [n("Gemm", "state w b", "y", alpha=0.5, beta=2.0)]),
        ("transposed", [n("Gemm", "state w", "y", transB=1)]),
        ("both", [n("Transpose", "state", "s", perm=[1, 0]), n("Gemm", "s w half", "y", transA=1, transB=1)]),
    ],
    "ReduceSum": [
        ("", [n("Mul", "state w", "m"), n("ReduceSum", "m last", "y", keepdims=0)]),
        ("first", [n("Mul", "state w", "m"), n("Constant", "", "zero", value_ints=[0]), n("ReduceSum", "m zero", "y")]),
        ("all", [n("Mul", "state w", "m"), n("ReduceSum", "m", "y")]),
        ("none", [n("ReduceSum", "state", "y", noop_with_empty_axes=1)]),
    ],
    "Constant": [
        ("tensor", [n("Constant", "", "c", value=numpy_helper.from_array(WEIGHTS["b"])), n("Add", "state c", "y")]),
        ("whole", [n("Constant", "", "c", value_int=2), n("Gather", "state c", "y", axis=1)]),
    ],
    "Shape": [
        ("", [n("Shape", "state", "s"), n("Expand", "u s", "y")]),
        ("end", [n("Shape", "state", "s", start=-1), n("Cast", "s", "k", to=DOUBLE), n("Mul", "state k", "y")]),
    ],
}


def graph_of(nodes: list[onnx.NodeProto], kind: int) -> onnx.GraphProto:
    """A graph whose theta is the sum of y and whose next_state holds y's first entry twice and its last twice."""
    ends = [
        n("Reshape", "y last", "flat"),
        n("Gather", "flat picks", "picked"),
        n("Reshape", "picked to_row", "next_state"),
        n("ReduceSum", "flat", "sum", keepdims=1),
        n("Reshape", "sum single", "theta"),
    ]
    floats = np.float32 if kind == FLOAT else np.float64
    arrays = {k: v.astype(floats) if v.dtype.kind == "f" else v for k, v in WEIGHTS.items()}
    arrays |= {"single": np.array([1, 1]), "picks": np.array([0, 0, -1, -1])}
    values = [helper.make_tensor_value_info(k, kind, [1, s]) for k, s in (("u", 1), ("state", SIZE))]
    outputs = [helper.make_tensor_value_info(k, kind, [1, s]) for k, s in (("theta", 1), ("next_state", SIZE))]
    copies = [onnx.NodeProto.FromString(node.SerializeToString()) for node in nodes]
    for item in (item for node in copies for item in node.attribute if kind == FLOAT):
        if item.name == "to" and item.i == DOUBLE:
            item.i = FLOAT
        if item.HasField("t") and item.t.data_type == DOUBLE:
            item.t.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(item.t).astype(np.float32)))
    tensors = [numpy_helper.from_array(v, k) for k, v in arrays.items()]
    return helper.make_graph(copies + ends, "case", values, outputs, tensors)


# float64 where onnxruntime has a kernel for it, else float32: all versions have Erf for that only, older ones Cos too.
PRECISIONS = ((DOUBLE, np.float64, 1e-12), (FLOAT, np.float32, 2e-5))


def runtime(nodes: list[onnx.NodeProto]) -> tuple[onnx.GraphProto, ort.InferenceSession, Any, float]:
    """Graph, session, type of the numbers and how far they may be off, in the best precision that onnxruntime has."""
    opset = [helper.make_opsetid("", OPSET)]
    for kind, floats, tolerance in PRECISIONS:
        graph = graph_of(nodes, kind)
        model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION)
        try:
            session = ort.InferenceSession(model.SerializeToString(), one_thread(), providers=["CPUExecutionProvider"])
        except NotImplemented_:
            continue
        return graph, session, floats, tolerance
    raise AssertionError("onnxruntime has no kernel for it")


LISTED = [pytest.param(op, nodes, id=f"{op} {name}".strip()) for op, rows in CASES.items() for name, nodes in rows]


def test_every_listed_operator_has_a_case() -> None:
    assert set(CASES) == ALLOWED
    for op, rows in CASES.items():
        assert all(op in [node.op_type for node in nodes] for _, nodes in rows), op


@pytest.mark.parametrize(("op", "nodes"), LISTED)
def test_operator_agrees_with_onnxruntime(op: str, nodes: list[onnx.NodeProto]) -> None:
    graph, session, floats, tolerance = runtime(nodes)
    function = to_casadi(graph)
    for state, u in (([0.7, -1.4, 2.2, -0.3], 1.3), ([-2.0, 0.5, 0.0, 1.0], -0.9), ([1.0, -1.0, 0.0, 2.0], 0.25)):
        fed = {"u": np.full((1, 1), u, floats), "state": np.array(state, floats)[None]}
        expected = session.run(["theta", "next_state"], fed)
        got = function(state, u)
        for ours, theirs in zip(got, expected, strict=True):
            np.testing.assert_allclose(np.array(ours), theirs.T, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize(("op", "nodes"), LISTED)
def test_derivative_agrees_with_differences(op: str, nodes: list[onnx.NodeProto]) -> None:
    function = to_casadi(graph_of(nodes, DOUBLE))
    x = ca.MX.sym("x", SIZE + 1)
    jacobian = ca.Function("j", [x], [ca.jacobian(ca.vertcat(*function(x[:SIZE], x[SIZE])), x)])
    point, h = np.array([0.7, -1.4, 2.2, -0.3, 1.3]), 1e-6
    differences = []
    for nudge in h * np.eye(SIZE + 1):
        ahead, behind = (ca.vertcat(*function(p[:SIZE], p[SIZE])) for p in (point + nudge, point - nudge))
        differences.append(np.array(ahead - behind).ravel() / (2 * h))
    np.testing.assert_allclose(np.array(jacobian(point)), np.array(differences).T, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("op", "inputs", "by_state", "by_u"),
    [("Max", "state u", 1, 0), ("Min", "state u", 1, 0), ("Max", "u state", 0, 1), ("Min", "u state", 0, 1)],
)
def test_first_operand_is_active_at_a_tie(op: str, inputs: str, by_state: float, by_u: float) -> None:
    function = to_casadi(graph_of([n(op, inputs, "y")], DOUBLE))
    x, u = ca.MX.sym("x", SIZE), ca.MX.sym("u")
    theta = function(x, u)[0] / SIZE
    slopes = ca.Function("s", [x, u], [ca.jacobian(theta, x), ca.jacobian(theta, u)])
    got_state, got_u = slopes([2.0] * SIZE, 2.0)
    np.testing.assert_array_equal(np.array(got_state)[0], [by_state / SIZE] * SIZE)
    assert float(got_u) == by_u


def test_far_saturation_has_finite_derivatives() -> None:
    for op in ("Sigmoid", "Softplus", "Tanh"):
        function = to_casadi(graph_of([n(op, "state", "y")], DOUBLE))
        x = ca.MX.sym("x", SIZE)
        slope = ca.Function("s", [x], [ca.jacobian(function(x, 0)[0], x)])
        got = np.array(slope([-1e4, 1e4, -800.0, 800.0]))
        np.testing.assert_allclose(got, [[0, 1, 0, 1]] if op == "Softplus" else np.zeros((1, SIZE)), atol=1e-12)


def test_chains_are_expanded_and_wide_products_are_not() -> None:
    small = to_casadi(graph_of([n("Tanh", "state", "y")], DOUBLE))
    assert small.is_a("SXFunction")
    wide = graph_of([n("MatMul", "state up", "m"), n("MatMul", "m down", "y")], DOUBLE)
    weights = {"up": np.ones((SIZE, 600)), "down": np.ones((600, SIZE))}
    wide.initializer.extend([numpy_helper.from_array(v, k) for k, v in weights.items()])
    assert to_casadi(wide).is_a("MXFunction")


def test_zero_weights_leave_no_trace_in_the_sparsity() -> None:
    graph = graph_of([n("MatMul", "state diagonal", "y")], DOUBLE)
    graph.initializer.append(numpy_helper.from_array(np.diag([1.0, 2.0, 0.0, 3.0]), "diagonal"))
    function = to_casadi(graph)
    x = ca.MX.sym("x", SIZE)
    assert ca.jacobian(function(x, 0)[1], x).nnz() == 4  # picks 0, 0, -1, -1 of a diagonal map


def test_function_sits_in_a_users_own_problem() -> None:
    """Single shooting through a play in IPOPT: reach 3 and hold, from contact below, in ten moves of at most 0.5."""
    nodes = [
        n("Sub", "u half", "low"),
        n("Add", "u half", "high"),
        n("Min", "high state", "held"),
        n("Max", "low held", "y"),
    ]
    play = to_casadi(graph_of(nodes, DOUBLE))
    plan, x, last, cost = ca.MX.sym("plan", 10), ca.DM.zeros(SIZE), 0.0, 0.0
    moves = []
    for k in range(10):
        theta, x = play(x, plan[k])
        cost += (theta / SIZE - 3.0) ** 2 + 1e-3 * (plan[k] - last) ** 2
        moves.append(plan[k] - last)
        last = plan[k]
    problem = {"x": plan, "f": cost, "g": ca.vertcat(*moves)}
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    answer = solver(x0=np.full(10, 1.0), lbg=-0.5, ubg=0.5, lbx=0.0, ubx=6.0)
    assert solver.stats()["success"]
    commands = np.array(answer["x"]).ravel()
    assert np.all(np.abs(np.diff(commands, prepend=0.0)) <= 0.5 + 1e-6)
    # the play lags by its half-width, so the command ends half a unit above the angle it holds
    assert commands[-1] == pytest.approx(3.5, abs=0.01)


def test_untranslatable_node_is_named() -> None:
    graph = graph_of([helper.make_node("Reshape", ["state", "to_row_five"], ["y"], name="fold")], DOUBLE)
    graph.initializer.append(numpy_helper.from_array(np.array([1, 5]), "to_row_five"))
    with pytest.raises(ModelError, match=r"tip: node 'fold' \(Reshape\): cannot reshape"):
        to_casadi(graph, "tip")


def test_index_that_depends_on_the_state_is_refused() -> None:
    nodes = [n("Cast", "state", "i", to=INT64), n("Gather", "b i", "y")]
    with pytest.raises(ModelError, match=r"\(Gather\): an axis, size or index depends on command or state"):
        to_casadi(graph_of(nodes, DOUBLE))
