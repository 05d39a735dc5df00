"""The C compiles without a warning; what has none is refused. It runs clean under sanitizers: see test_fuzz."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.codegen import export_controller
from hystmpc.trials.errors import ExportError

from .compiled import EXAMPLES, STRICT, compile_c, compilers, tried
from .test_commands import CASES, tip


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_it_compiles_without_a_warning(case: str, tmp_path: Path) -> None:
    """In single precision; in double each case is compiled as strictly where its commands are compared.

    Cases differ in their numbers and in which files they take: what an optimiser finds is looked for in two below.
    """
    export_controller(CASES[case][0], single=True, folder=EXAMPLES).write(tmp_path)
    compile_c([*STRICT, "-fsyntax-only", "hystmpc.c"], tmp_path)


@pytest.mark.slow
def test_every_compiler_takes_it_without_a_warning(tmp_path: Path) -> None:
    """The first one also by what its optimiser finds, of which the others do not warn; double: see test_networks."""
    export_controller(CASES["lag-of-the-settings"][0], single=True, folder=EXAMPLES).write(tmp_path)
    for k, command in enumerate(compilers()):
        assert tried([*command, *STRICT, "-O0" if k else "-O2", "-c", "hystmpc.c"], tmp_path) == ""


def test_nothing_is_taken_from_the_heap() -> None:
    source = export_controller(CASES["plays"][0], folder=EXAMPLES).source
    plain = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    vectors = {"immintrin.h", "arm_neon.h"}  # of a network, where the processor has them
    included = set(re.findall(r"#include <(.*)>", plain))
    assert included - vectors == {"float.h", "math.h", "stddef.h", "stdint.h", "string.h"}
    assert re.findall(r"\b(?:malloc|calloc|realloc|free|alloca|printf)\(", plain) == []


def test_no_table_is_written_twice() -> None:
    """The numbers that several structs point to stand there once."""
    source = export_controller(CASES["network-behind-a-lag"][0], folder=EXAMPLES).source
    tables = re.findall(
        r"^static const (?:real|int|float) a\d+\[\] = (\{.*?\});", source, flags=re.DOTALL | re.MULTILINE
    )
    assert len(tables) > 10
    assert len(set(tables)) == len(tables)


def test_the_numbers_are_exact() -> None:
    export = export_controller(CASES["given-sigmas"][0], folder=EXAMPLES)
    fields = export.problem.fields
    assert f".reach = {fields['reach']!r}," in export.source
    assert f".dt_s = {fields['dt_s']!r}," in export.source
    tracking = fields["law"].fields["planner"].fields["law"].fields["tracking"].tolist()
    assert ", ".join(map(repr, tracking[-5:])) in " ".join(export.source.split())
    single = export_controller(CASES["given-sigmas"][0], single=True, folder=EXAMPLES)
    assert f".reach = {np.format_float_scientific(np.float32(fields['reach']), trim='0')}F," in single.source


REFUSED: Mapping[str, tuple[dict[str, Any], str]] = {
    "osqp": (tip("builtin:pi", solver="osqp"), "got controller.solver osqp, supported is active_set"),
    "a law in Python": (
        {"model": "builtin:pi", "controller": {"kind": "python", "python": "tests.codegen.own_law:OwnSettings"}},
        "got the law OwnSettings written in Python",
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
    assert re.search(r"(\d+) bytes, of which (\d+) are remembered; calls fabs, sqrt, rint of <math.h>", said)
    assert run.invoke(app, arguments).exit_code != 0
    assert run.invoke(app, [*arguments, "--force", "--float32"]).exit_code == 0
    assert "typedef float hystmpc_real;" in (folder / "hystmpc.h").read_text(encoding="utf-8")
