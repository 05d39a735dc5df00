"""Loading: files that are foreign, damaged, of another version or beside the contract are refused in one line."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from hystmpc.models.contract.load import IR_VERSION, OPSET, OnnxModel, load_onnx
from hystmpc.models.contract.metadata import FORMAT, ModelMetadata
from hystmpc.trials.errors import ModelError

from ..refusals import names

METADATA = ModelMetadata.parse(
    {
        "kind": "lag",
        "dt_s": 0.04,
        "command_unit": "bar",
        "command_limits": {"lower": 0.0, "upper": 3.0},
        "command_rate": 2.0,
        "trained_command": {"lower": 0.0, "upper": 3.0},
        "trained_angle": {"lower": 0.0, "upper": 30.0},
        "trained_rate": 2.0,
        "initial": {"offset": [0.0, 1.0], "slope": [0.1, 0.0]},
        "conditioned": {"offset": [0.5, 0.0], "slope": [0.0, 0.0]},
        "warmup_samples": 0,
        "training_data_hash": "",
    }
)


def lag_model() -> onnx.ModelProto:
    """x+ = A x + B u, theta = 10 (first entry of x+)."""
    nodes = [
        helper.make_node("Concat", ["state", "u"], ["all"], axis=1, name="join"),
        helper.make_node("MatMul", ["all", "ab"], ["next_state"], name="propagate"),
        helper.make_node("MatMul", ["next_state", "c"], ["theta"], name="show"),
    ]
    weights = {"ab": np.array([[0.9, 0.0], [0.1, 0.8], [0.0, 0.2]]), "c": np.array([[10.0], [0.0]])}
    sizes = {"u": 1, "state": 2, "theta": 1, "next_state": 2}
    values = [helper.make_tensor_value_info(k, TensorProto.DOUBLE, ["N", s]) for k, s in sizes.items()]
    tensors = [numpy_helper.from_array(v, k) for k, v in weights.items()]
    graph = helper.make_graph(nodes, "lag", values[:2], values[2:], tensors)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION)
    helper.set_model_props(model, METADATA.to_properties())
    return model


def set_property(model: onnx.ModelProto, key: str, text: str) -> None:
    helper.set_model_props(model, {item.key: item.value for item in model.metadata_props} | {f"hystmpc.{key}": text})


def replace_weight(model: onnx.ModelProto, values: Any) -> None:
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(np.array(values), "ab"))


def retype(model: onnx.ModelProto, which: str, kind: int | None = None, shape: list[Any] | None = None) -> None:
    for value in (*model.graph.input, *model.graph.output):
        if value.name == which:
            old = value.type.tensor_type
            value.CopyFrom(helper.make_tensor_value_info(which, kind or old.elem_type, shape or ["N", 1]))


def drop_metadata(model: onnx.ModelProto) -> None:
    del model.metadata_props[:]


def drop_training(model: onnx.ModelProto) -> None:
    helper.set_model_props(model, {k: v for k, v in METADATA.to_properties().items() if k != "hystmpc.training"})


def other_version(model: onnx.ModelProto) -> None:
    set_property(model, "format", '"hystmpc-model/2"')
    set_property(model, "horizon", "3")  # what a later version may have added


def external_weight(model: onnx.ModelProto) -> None:
    onnx.external_data_helper.set_external_data(model.graph.initializer[0], "weights.bin")


def loop_node(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node("Loop", ["", ""], ["x"], name="again", body=onnx.GraphProto()))


def custom_node(model: onnx.ModelProto) -> None:
    model.graph.node[0].domain = "com.example"


def constant_with_nan(model: onnx.ModelProto) -> None:
    value = numpy_helper.from_array(np.array([1.0, np.nan]))
    model.graph.node.insert(0, helper.make_node("Constant", [], ["unused"], value=value))


def local_function(model: onnx.ModelProto) -> None:
    opset = [helper.make_opsetid("", OPSET)]
    node = helper.make_node("Loop", ["a"], ["b"])
    model.functions.append(helper.make_function("local", "MatMul", ["a"], ["b"], [node], opset))


def missing_output(model: onnx.ModelProto) -> None:
    del model.graph.output[1]


def dangling_input(model: onnx.ModelProto) -> None:
    model.graph.node[1].input[0] = "nowhere"


def frozen_batch(model: onnx.ModelProto) -> None:
    """The batch axis is free by declaration, but a Reshape freezes it."""
    model.graph.initializer.append(numpy_helper.from_array(np.array([1, 3]), "one_row"))
    model.graph.node.insert(1, helper.make_node("Reshape", ["all", "one_row"], ["frozen"]))
    model.graph.node[2].input[0] = "frozen"


def lost_batch(model: onnx.ModelProto) -> None:
    """theta is one row for the whole batch."""
    model.graph.initializer.append(numpy_helper.from_array(np.array([0]), "rows"))
    model.graph.node[2].output[0] = "each"
    model.graph.node.append(helper.make_node("ReduceSum", ["each", "rows"], ["theta"]))


NAN, INF = float("nan"), float("inf")
BESIDE: list[tuple[str, Callable[[onnx.ModelProto], None], str]] = [
    ("foreign", drop_metadata, r"foreign ONNX file, no 'hystmpc\.format'"),
    ("version", other_version, r"model format 'hystmpc-model/2', this version of hystmpc reads 'hystmpc-model/1'"),
    (
        "not JSON",
        lambda m: set_property(m, "dt_s", "0.04s"),
        r"hystmpc\.dt_s: got '0\.04s', expected JSON",
    ),
    (
        "bad value",
        lambda m: set_property(m, "dt_s", "-1.0"),
        r"metadata: dt_s: .* or equal to 0\.00001, got -1\.0",
    ),
    ("not finite", lambda m: set_property(m, "dt_s", "NaN"), r"metadata: dt_s: .*"),
    ("unknown key", lambda m: set_property(m, "dts", "1"), r"unknown key 'dts'.*did you mean 'dt_s'"),
    ("empty range", lambda m: set_property(m, "trained_angle", '{"lower": 2, "upper": 1}'), "not below upper"),
    ("no training facts", drop_training, "metadata lacks training; the file is cut off or was edited"),
    ("unit", lambda m: set_property(m, "angle_unit", '"rad"'), "angle_unit is 'rad', expected 'deg' for one"),
    ("loop", loop_node, "node 'again' uses operator 'Loop', which is not on the list, available: Abs, Add"),
    ("custom", custom_node, r"node 'join' uses operator 'com\.example\.Concat'"),
    ("function", local_function, "1 functions, expected"),
    ("opset", lambda m: setattr(m.opset_import[0], "version", 13), r"operator sets \{'': 13\}"),
    ("NaN", lambda m: replace_weight(m, [[0.9, 0], [NAN, 1], [0, 0]]), "initializer 'ab' is nan at entry 2"),
    ("infinite", lambda m: replace_weight(m, [[INF, 0], [0, 1], [0, 0]]), "initializer 'ab' is inf at entry 0"),
    ("NaN constant", constant_with_nan, r"node 0 \(output 'unused'\) is nan at entry 1"),
    ("external", external_weight, "initializer 'ab' lies outside the file"),
    ("short weight", lambda m: setattr(m.graph.initializer[0], "raw_data", b"123"), "initializer 'ab' cannot be read"),
    (
        "state size",
        lambda m: retype(m, "state", shape=["N", 3]),
        r"inputs are 'state' float64 \[N,3\], 'u'",
    ),
    ("fixed batch", lambda m: retype(m, "u", shape=[1, 1]), r"inputs are 'state' float64 \[N,2\], 'u' float64 \[1,1\]"),
    ("mixed types", lambda m: retype(m, "theta", kind=TensorProto.FLOAT), r"'theta' float32 \[N,1\], expected"),
    ("whole numbers", lambda m: retype(m, "u", kind=TensorProto.INT64), "inputs are .* 'u' type 7"),
    ("missing output", missing_output, r"outputs are 'theta' float64 \[N,1\], expected 'next_state'"),
    ("dangling", dangling_input, "not a valid ONNX graph: .*nowhere"),
    ("frozen batch", frozen_batch, "onnxruntime refuses the graph"),
    ("lost batch", lost_batch, r"a batch of 2 gives theta \(1, 1\)"),
    ("shapes", lambda m: replace_weight(m, np.ones((4, 2))), "not a valid ONNX graph|onnxruntime refuses"),
]


def saved(model: onnx.ModelProto, folder: Path) -> Path:
    path = folder / "model.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        load_onnx(path)
    text = str(caught.value)
    assert names(text, path)
    assert "\n" not in text
    return text


def test_the_untouched_model_loads_and_steps(tmp_path: Path) -> None:
    model = load_onnx(saved(lag_model(), tmp_path))
    assert model.metadata == METADATA
    theta, state = model.advance(np.array([[1.0, 2.0]]), np.array([[3.0]]))
    np.testing.assert_allclose(state, [[1.1, 2.2]])
    np.testing.assert_allclose(theta, [[11.0]])


@pytest.mark.parametrize(("change", "text"), [pytest.param(c, t, id=name) for name, c, t in BESIDE])
def test_model_beside_the_contract_is_refused(
    change: Callable[[onnx.ModelProto], None], text: str, tmp_path: Path
) -> None:
    proto = lag_model()
    change(proto)
    path = saved(proto, tmp_path)
    message = refusal(path)
    assert re.search(text, message), message


class Trap:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickle_is_never_loaded(protocol: int, tmp_path: Path) -> None:
    path, trap = tmp_path / "model.onnx", tmp_path / "sprung"
    path.write_bytes(pickle.dumps(Trap(trap), protocol))
    refusal(path)
    assert not trap.exists()


def test_missing_file_and_folder(tmp_path: Path) -> None:
    assert "cannot be read (No such file or directory), expected an ONNX file" in refusal(tmp_path / "none.onnx")
    assert "cannot be read" in refusal(tmp_path)


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    content = lag_model().SerializeToString()
    path = tmp_path / "model.onnx"
    for length in range(len(content)):
        path.write_bytes(content[:length])
        refusal(path)


@given(st.binary(max_size=300))
def test_arbitrary_bytes_are_refused_with_a_model_error(content: bytes) -> None:
    with pytest.raises(ModelError):
        OnnxModel(content)


@given(st.data())
def test_damaged_file_is_refused_or_still_a_model(data: st.DataObject) -> None:
    content = bytearray(lag_model().SerializeToString())
    content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        model = OnnxModel(bytes(content))
    except ModelError:
        return
    assert model.metadata.format == FORMAT
    assert model.advance(np.zeros((3, 2)), np.zeros((3, 1)))[1].shape == (3, 2)


def test_wrong_shapes_of_state_and_command(tmp_path: Path) -> None:
    model = load_onnx(saved(lag_model(), tmp_path))
    for state, u in (((1, 2), (2, 1)), ((2, 3), (2, 1)), ((2, 2), (2, 2)), ((2, 2), (2,)), ((2,), (1, 1))):
        with pytest.raises(ModelError, match=r"got states .* and commands .*, expected \(N, 2\) and \(N, 1\)"):
            model.advance(np.zeros(state), np.zeros(u))


def test_unknown_start_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="start is 'cold', available: conditioned, initial"):
        load_onnx(saved(lag_model(), tmp_path), start="cold")  # type: ignore[arg-type]


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5))
def test_initial_rule_is_affine_in_the_angle(angles: list[float]) -> None:
    y = np.array(angles)[:, None]
    state = METADATA.initial.state(y)
    assert state.shape == (len(angles), 2)
    np.testing.assert_allclose(state, np.hstack([0.1 * y, np.ones_like(y)]))


def test_metadata_properties_are_one_json_value_a_key() -> None:
    properties = METADATA.to_properties()
    assert properties["hystmpc.dt_s"] == "0.04"
    assert set(properties) == {f"hystmpc.{name}" for name in ModelMetadata.model_fields}
    assert ModelMetadata.from_properties({**properties, "author": "someone"}, "here") == METADATA
