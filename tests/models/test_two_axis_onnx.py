"""ONNX files of two axes: the Python free run in onnxruntime alone, the rule of the start, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import onnxruntime
import pytest
from typer.testing import CliRunner

import hystmpc
from hystmpc.cli.main import app
from hystmpc.models.contract.export import TOLERANCE_DEG
from hystmpc.models.load import load_model
from hystmpc.models.two_axes.exported import TwoAxisStep, export_two_axes
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.trials.errors import ExportError, ModelError
from hystmpc.trials.types import Vec

from .two_axis_examples import COUPLED, SHARED, two_axes, wandering

MIX, FRAME = ((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0))
TENDONS = {"pretension": 1.0, "limits": [(0.2, 4.0)] * 4, "rates_per_s": [8.0] * 4}
MODELS: Mapping[str, Callable[[], TwoAxisModel]] = {
    "apart": two_axes,
    "turned, that share friction": lambda: two_axes(MIX, FRAME, SHARED),
    "turned, late and coupled": lambda: two_axes(MIX, FRAME, COUPLED),
    "four tendons": lambda: two_axes(cross=SHARED).with_tendons([0, 90, 180, 270], **TENDONS),
}
of_each_model = pytest.mark.parametrize("name", MODELS)


class Runtime:
    """A file in onnxruntime, as a program without hystmpc runs it."""

    def __init__(self, path: Path) -> None:
        self.session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        properties = self.session.get_modelmeta().custom_metadata_map
        self.facts = {key.removeprefix("hystmpc."): json.loads(text) for key, text in properties.items()}

    def step(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        theta, following = self.session.run(["theta", "next_state"], {"u": u, "state": state})
        return np.asarray(theta), np.asarray(following)

    def run(self, state: Vec, commands: Vec) -> Vec:
        """Angles (T, 2) over commands (T, n) from a state (S,)."""
        at, angles = state[None], []
        for u in commands:
            theta, at = self.step(at, u[None])
            angles.append(theta[0])
        return np.array(angles)

    def at_rest(self, angles_deg: Vec, commands: Vec) -> Vec:
        """The state by the rule of the metadata, after its warm-up."""
        rule = {name: np.array(value) for name, value in self.facts["initial"].items()}
        state = rule["offset"] + rule["by_angle"] @ angles_deg + rule["by_command"] @ (commands - rule["at_command"])
        at = state[None]
        for _ in range(self.facts["warmup_samples"]):
            _, at = self.step(at, commands[None])
        return at[0]


def commands_of(model: TwoAxisModel, seed: int = 1) -> Vec:
    """Commands (T, n) within the limits that begin at rest."""
    u = np.vstack([np.zeros((1, 2)), wandering(seed, 400)])
    return model.commands(0.3 * u) if len(model.command_limits) > 2 else u


@of_each_model
def test_the_file_alone_repeats_the_free_run_of_python(name: str, tmp_path: Path) -> None:
    """From the same state at rest; the bar is that of one axis."""
    model = MODELS[name]()
    report = export_two_axes(model, tmp_path / "both.onnx")
    assert max(report.runtime_deg, report.casadi_deg) <= TOLERANCE_DEG
    file, u, start = Runtime(tmp_path / "both.onnx"), commands_of(model), np.array([2.0, -1.0])
    expected = model.run(u, start)
    assert np.ptp(expected, axis=0).min() > 4.0
    state = TwoAxisStep(model).at_rest(start, u[0])
    assert np.abs(file.run(state, u) - expected).max() <= TOLERANCE_DEG


@of_each_model
def test_rule_and_warm_up_lead_to_the_rest_at_the_rest_commands(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    export_two_axes(model, tmp_path / "both.onnx")
    file, rest = Runtime(tmp_path / "both.onnx"), np.array(model.rest_commands)
    start, u = np.zeros(2), commands_of(model, 2)
    np.testing.assert_allclose(u[0], rest, atol=1e-12)
    off = file.run(file.at_rest(start, rest), u) - model.run(u, start)
    assert np.abs(off).max() <= TOLERANCE_DEG


def test_the_metadata_say_what_a_program_needs(tmp_path: Path) -> None:
    model = MODELS["four tendons"]()
    export_two_axes(model, tmp_path / "both.onnx")
    facts = Runtime(tmp_path / "both.onnx").facts
    assert (facts["format"], facts["dt_s"], facts["command_unit"]) == ("hystmpc-two-axes-model/1", 0.04, "mm")
    assert (facts["command_limits"], facts["command_rates_per_s"]) == ([[0.2, 4.0]] * 4, [8.0] * 4)
    assert facts["rest_commands"] == [1.0] * 4


def test_rows_of_a_batch_do_not_know_each_other(tmp_path: Path) -> None:
    model = MODELS["turned, late and coupled"]()
    export_two_axes(model, tmp_path / "both.onnx")
    file, random = Runtime(tmp_path / "both.onnx"), np.random.default_rng(1)
    states, u = random.normal(0.0, 1.0, (5, TwoAxisStep(model).state_size)), random.uniform(-3.0, 3.0, (5, 2))
    whole = np.hstack(file.step(states, u))
    single = [np.hstack(file.step(states[k : k + 1], u[k : k + 1])) for k in range(5)]
    np.testing.assert_allclose(whole, np.vstack(single), rtol=0, atol=1e-12)


def test_a_graph_that_differs_from_the_engine_is_not_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    model = MODELS["turned, that share friction"]()
    right = TwoAxisStep(model).function

    def wrong(_: TwoAxisStep) -> Any:
        x, u = ca.SX.sym("x", right.numel_in(0)), ca.SX.sym("u", 2)
        theta, following = right(x, u)
        return ca.Function("model", [x, u], [ca.densify(theta + ca.DM([0.0, 0.002])), following])

    monkeypatch.setattr(TwoAxisStep, "function", cached_property(wrong))
    TwoAxisStep.function.__set_name__(TwoAxisStep, "function")
    (tmp_path / "both.onnx").write_bytes(b"older")
    with pytest.raises(ExportError, match=r"both\.onnx: onnxruntime .* expected .* of the reference within"):
        export_two_axes(model, tmp_path / "both.onnx")
    assert (tmp_path / "both.onnx").read_bytes() == b"older"


def test_the_command_writes_it_and_a_reader_of_one_axis_says_what_it_is(tmp_path: Path) -> None:
    run, out = CliRunner(), tmp_path / "both.onnx"
    model = MODELS["apart"]()
    arguments = ["export", str(model.save(tmp_path / "both.yaml")), "--out", str(out)]
    done = run.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "1000 steps within" in " ".join(done.output.split())
    assert run.invoke(app, arguments).exit_code != 0
    assert run.invoke(app, [*arguments, "--force"]).exit_code == 0
    with pytest.raises(ModelError, match="an exported model of two axes, which hystmpc does not open") as raised:
        load_model(out)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) <= 300 + len(str(tmp_path))
    assert hystmpc.export(model, out, force=True).steps == 1000
