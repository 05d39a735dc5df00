"""The examples around an exported controller run as they say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hystmpc.codegen import export_controller

from .compiled import EXAMPLES, STRICT, compile_c

FOLDER = EXAMPLES / "exported_c"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the controller of `examples/tip.yaml` as C, and compiled for a library or a program."""
    folder = tmp_path_factory.mktemp("exported")
    export_controller(EXAMPLES / "tip.yaml").write(folder)
    compile_c([*STRICT, "-O0", "-fPIC", "-c", "hystmpc.c", "-o", "hystmpc.o"], folder)
    return folder


def reached(text: str) -> list[float]:
    """Errors at the ends of the motions [deg]."""
    return [float(b) - float(a) for a, b in re.findall(r"target ([\d.]+) deg, reached ([\d.]+) deg", text)]


@pytest.mark.slow
def test_the_loop_in_python(exported: Path) -> None:
    compile_c(["-shared", "hystmpc.o", "-o", "hystmpc.so", "-lm"], exported)
    command = [sys.executable, FOLDER / "loop.py", exported / "hystmpc.so"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    errors = reached(done.stdout)
    assert len(errors) == 3
    assert max(map(abs, errors)) <= 0.2


@pytest.mark.slow
def test_the_loop_in_cpp(exported: Path) -> None:
    warnings = ["-std=c++11", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    compile_c([*warnings, "-I", ".", str(FOLDER / "loop.cpp"), "hystmpc.o", "-o", "loop"], exported, "c++")
    run = subprocess.run([exported / "loop"], capture_output=True, text=True, timeout=60, check=True)
    errors = reached(run.stdout)
    assert len(errors) == 3
    assert max(map(abs, errors)) <= 0.2
