"""Networks of any size in the exported C, by small ones that answer to the command with a lag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystmpc.codegen import export_controller
from hystmpc.models.contract.export import ExportBundle, model_bytes
from hystmpc.models.kernels.vector_emitter import host_shape
from hystmpc.models.networks.lstm import LstmLayer, LstmStep, LstmWeights, lstm_step_graph
from hystmpc.models.networks.nodes import Scaling
from hystmpc.trials.errors import ExportError
from tests.models.lstm_examples import facts

from .compiled import NETWORK, STRICT, compilers, library, run_sanitized, tried
from .loops import compare
from .test_commands import PLAIN, SAME, tip


def small_lstm(hidden: int, layers: int, folder: Path, kind: str = "lstm") -> str:
    """File of an LSTM whose angle rises with the command from about 30 to about 85 deg."""
    random, stack = np.random.default_rng(hidden), []
    for k in range(layers):
        inputs = 1 if k == 0 else hidden
        w_ih = np.zeros((4, hidden, inputs))
        w_ih[2] = random.uniform(0.5, 1.0, (hidden, inputs)) / inputs
        w_hh = 0.1 * random.normal(size=(4 * hidden, hidden)) / hidden**0.5
        stack.append(LstmLayer(w_ih.reshape(4 * hidden, inputs), w_hh, random.normal(0.0, 0.3, 4 * hidden)))
    plain = LstmWeights(tuple(stack), random.uniform(0.5, 1.5, hidden) / hidden, 0.0, Scaling(3.0, 3.0, 0.0, 1.0))
    step, held = LstmStep(plain), []
    for u in (0.0, 6.0):
        state, angle = np.zeros((1, step.state_size)), np.zeros((1, 1))
        for _ in range(100):
            angle, state = step.advance(state, np.array([[u]]))
        held.append(angle.item())
    gain = 55.0 / (held[1] - held[0])
    scaled = LstmWeights(plain.layers, plain.head_weight, 0.0, Scaling(3.0, 3.0, 30.0 - gain * held[0], gain))
    weights = LstmWeights.from_arrays({n: a.astype(np.float32) for n, a in scaled.to_arrays().items()})
    about = facts(weights).model_copy(update={"kind": kind})
    bundle = ExportBundle(lstm_step_graph(weights), about, LstmStep(weights), np.linspace(0.0, 6.0, 50))
    path = folder / f"lstm_{hidden}_{layers}.onnx"
    path.write_bytes(model_bytes(bundle))
    return str(path)


SIZES = pytest.mark.parametrize(
    "size", [(5, 1), *(pytest.param(size, marks=pytest.mark.slow) for size in [(20, 1), (33, 2), (16, 3)])], ids=str
)


@SIZES
def test_commands_are_those_of_python_for_any_size(size: tuple[int, int], tmp_path: Path) -> None:
    if host_shape() is None:
        pytest.skip("the processor has neither AVX-512 nor AVX2: Python's plain route rounds otherwise than the C")
    settings = tip(small_lstm(*size, tmp_path), **PLAIN)
    found = compare(settings, library(settings, tmp_path), 200, seed=2)
    assert found.greatest <= SAME
    assert found.same_sources
    assert float(np.ptp(found.c)) > 1.0


def test_without_fused_instructions_commands_stay_close(tmp_path: Path) -> None:
    """The products are then rounded by way of double."""
    settings = tip(small_lstm(20, 1, tmp_path), **PLAIN)
    found = compare(settings, library(settings, tmp_path, options=("-O2",)), 200)
    assert found.greatest <= 1e-4


@pytest.mark.slow
def test_a_network_runs_clean_under_sanitizers(tmp_path: Path) -> None:
    run_sanitized(export_controller(tip(small_lstm(5, 1, tmp_path), 0.08)), tmp_path, 750)


@pytest.mark.slow
def test_every_compiler_takes_a_network_without_a_warning(tmp_path: Path) -> None:
    export_controller(tip(small_lstm(20, 2, tmp_path))).write(tmp_path)
    said = {command[-1]: tried([*command, *STRICT, *NETWORK, "-c", "hystmpc.c"], tmp_path) for command in compilers()}
    assert {command: text for command, text in said.items() if text} == {}


def test_the_weights_take_the_room_that_they_need(tmp_path: Path) -> None:
    """Four gates of 16 units each: bias, input and outputs of the layer itself, and of the layer below."""
    source = export_controller(tip(small_lstm(5, 2, tmp_path), **PLAIN)).source
    assert f"hystmpc_weights[{64 * (2 + 16) + 64 * (1 + 2 * 16)}]" in source
    assert "hystmpc_head[16]" in source


def test_a_network_without_c_is_refused_in_a_line(tmp_path: Path) -> None:
    line = "export-c: got a model of kind hb1 in an .onnx file, supported are"
    with pytest.raises(ExportError, match=line):
        export_controller(tip(small_lstm(5, 1, tmp_path, "hb1")))
