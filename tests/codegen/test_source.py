"""The C compiles without a warning, in one file and in parts, and runs clean under sanitizers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.codegen import export_controller
from hystmpc.models.program import BINARY, UNARY
from hystmpc.trials.errors import ExportError

from .compiled import EXAMPLES, STRICT, compile_c, compilers, run_sanitized, tried
from .test_commands import CASES, tip


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_it_compiles_without_a_warning(case: str, tmp_path: Path) -> None:
    """In single precision; in double each case is compiled as strictly where its commands are compared."""
    export_controller(CASES[case][0], single=True, folder=EXAMPLES).write(tmp_path)
    compile_c([*STRICT, "-O2", "-c", "hystmpc.c"], tmp_path)


@pytest.mark.slow
def test_every_compiler_takes_it_without_a_warning(tmp_path: Path) -> None:
    export_controller(CASES["lag-of-the-settings"][0], folder=EXAMPLES).write(tmp_path)
    said = {command[-1]: tried([*command, *STRICT, "-O1", "-c", "hystmpc.c"], tmp_path) for command in compilers()}
    assert {command: text for command, text in said.items() if text} == {}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["plays", "blocks", "lag-of-the-settings", "network"])
def test_every_part_compiles_alone(case: str, tmp_path: Path) -> None:
    parts = export_controller(CASES[case][0], folder=EXAMPLES).parts
    for name, text in parts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    compile_c([*STRICT, "-c", *(name for name in parts if name.endswith(".c"))], tmp_path)


@pytest.mark.slow
def test_it_runs_clean_under_sanitizers(tmp_path: Path) -> None:
    """Moves in blocks; all other parts run under them where any function is called in any order, see test_fuzz."""
    run_sanitized(export_controller(CASES["blocks"][0], folder=EXAMPLES), tmp_path, 750)


def test_nothing_is_taken_from_the_heap() -> None:
    source = export_controller(CASES["plays"][0], folder=EXAMPLES).source
    assert re.findall(r"#include <(.*)>", source) == ["math.h"]
    assert re.findall(r"\b(?:malloc|calloc|realloc|free|alloca)\(", source) == []


def test_every_operation_of_the_operators_has_its_c() -> None:
    from hystmpc.codegen import steps

    calls = {"exp", "log", "tanh", "sin", "cos", "pow", "sqrt", "floor"}
    assert set(steps._TEMPLATES) | calls == {*BINARY, *UNARY}
    assert set(steps._FOLDED) == {*BINARY, *UNARY}


REFUSED: Mapping[str, tuple[dict[str, Any], str]] = {
    "pid": (
        {"model": "builtin:pi", "controller": {"kind": "pid"}},
        "got controller.kind pid, supported is linearised_mpc",
    ),
    "osqp": (tip("builtin:pi", solver="osqp"), "got controller.solver osqp, supported is active_set"),
    "frames": (
        tip("builtin:pi", estimator={"sensor": "intermittent"}),
        "got estimator.sensor intermittent, supported are continuous and none",
    ),
    "two lags": (
        tip("builtin:auto", 0.08),
        "got actuator_lag_s 0.08 beside lag in the model, supported is one of them",
    ),
    "one sample": (tip("builtin:pi", horizon=1), "got controller.horizon 1, supported are 2 samples or more"),
    "inverse": (
        {**tip("builtin:pi"), "inverse": "builtin:backlash"},
        "got inverse builtin:backlash, supported is the model's own",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_c_is_refused_in_a_line(case: str) -> None:
    settings, line = REFUSED[case]
    with pytest.raises(ExportError) as raised:
        export_controller(settings, folder=EXAMPLES)
    assert str(raised.value).startswith(f"export-c: {line}")
    assert "\n" not in str(raised.value)


def test_the_command_writes_two_files_and_says_what_they_need(tmp_path: Path) -> None:
    run, folder = CliRunner(), tmp_path / "c"
    arguments = ["export-c", str(EXAMPLES / "tip.yaml"), "--out", str(folder)]
    done = run.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in folder.iterdir()) == ["hystmpc.c", "hystmpc.h"]
    said = " ".join(done.output.split())
    assert "206544 bytes, of which 164144 are remembered; calls fabs, sqrt, rint of <math.h>" in said
    assert run.invoke(app, arguments).exit_code != 0
    assert run.invoke(app, [*arguments, "--force", "--float32"]).exit_code == 0
    assert "typedef float hystmpc_real;" in (folder / "hystmpc.h").read_text(encoding="utf-8")
