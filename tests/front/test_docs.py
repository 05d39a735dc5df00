"""Every Python block of README and docs runs, and it and the examples import nothing deeper than a room."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc

from ..models.two_axis_examples import two_axes
from .site_pages import extension

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
LESSONS = ("tutorials", "explanation", "own_effect", "own_controller")  # folders and pages
RUN_BY_THE_SITE = {  # `make docs` runs them, and stops where one raises
    f"{page.name}-0" for page in PAGES if page.parent.name in extension().EXECUTED
}
LONG = ("devices.md-0", "reconstruction.md-0")  # minutes; their imports are checked all the same


def blocks() -> list[tuple[str, str]]:
    """Page and number, and text, of every block; those of a lesson go on from one another and are one."""
    found = {page: BLOCK.findall(page.read_text(encoding="utf-8")) for page in PAGES}
    pieces = {
        page: ["\n".join(texts)] if texts and {page.parent.name, page.stem} & {*LESSONS} else texts
        for page, texts in found.items()
    }
    return [(f"{page.name}-{k}", text) for page, texts in pieces.items() for k, text in enumerate(texts)]


def imports(text: str) -> Iterator[str]:
    """Modules of the package that a text imports."""
    for node in ast.walk(ast.parse(text)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        yield from (name for name in names if name.partition(".")[0] == "hystmpc")


@pytest.mark.parametrize(("where", "text"), blocks(), ids=[where for where, _ in blocks()])
def test_blocks_import_no_deeper_than_a_room(where: str, text: str) -> None:
    assert [name for name in imports(text) if name.count(".") > 1] == []


@pytest.mark.parametrize(("where", "text"), [b for b in blocks() if b[0] in LONG])
def test_imports_of_long_blocks_are_there(where: str, text: str) -> None:
    for name in imports(text):
        pytest.importorskip(name)
    lines = [ast.unparse(n) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import | ast.ImportFrom)]
    exec(compile("\n".join(lines), where, "exec"), {})


@pytest.mark.parametrize("path", sorted((ROOT / "examples").rglob("*.py")), ids=lambda path: path.name)
def test_examples_import_no_deeper_than_a_room(path: Path) -> None:
    assert [name for name in imports(path.read_text(encoding="utf-8")) if name.count(".") > 1] == []


class Device:
    """What a page calls `device`: a simulated one behind two calls."""

    def __init__(self) -> None:
        self._plant = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator, seed=1)
        self._angle = self._plant.reset()

    def measure(self) -> float:
        return self._angle

    def send(self, command: float) -> None:
        self._angle = self._plant.apply(command)


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A folder with logs, models and the examples, and what pages take as given."""
    simulator = hystmpc.load_model("builtin:tendon-catheter").simulator
    plant = hystmpc.SimulatedPlant(simulator, seed=1)
    for k, hz in enumerate((0.2, 0.3, 0.25)):
        t = np.arange(0, 20, 0.04)
        u = 3 - 2.5 * np.cos(2 * np.pi * hz * t) * np.exp(-0.02 * t)
        plant.reset()
        angle = np.array([plant.apply(command) for command in u])
        hystmpc.write_csv(hystmpc.Trial(t, u, angle), tmp_path / "logs" / f"{k}.csv")
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    shutil.copy(next((ROOT / "models" / "library").glob("lstm*.onnx")), tmp_path / "lstm.onnx")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hystmpc.models.effects.catalogue._added", {})  # effects that a page adds are its own
    trials = hystmpc.read_trials("logs")
    given = {"trials": trials, "simulator": simulator, "chain": simulator.chain, "commands": trials[0].command[:50]}
    return given | {"device": Device(), "__name__": "page"}


HERE = [b for b in blocks() if b[0] not in (*LONG, *RUN_BY_THE_SITE)]


@pytest.mark.slow
@pytest.mark.parametrize(("where", "text"), HERE, ids=[where for where, _ in HERE])
def test_blocks_run(where: str, text: str, names: dict[str, Any]) -> None:
    if "both.onnx" in text:
        hystmpc.export(two_axes(), "both.onnx")
    exec(compile(text, where, "exec", dont_inherit=True), names)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")
def test_the_c_program_of_the_page_gives_the_angles_of_the_model(names: dict[str, Any]) -> None:
    page = (ROOT / "docs" / "howto" / "onnx.md").read_text(encoding="utf-8")
    (python,) = (text for text in BLOCK.findall(page) if "tip_model.c" in text)
    (program,) = (
        text for text in re.findall(r"^```cpp\n(.*?)^```", page, re.MULTILINE | re.DOTALL) if "tip_model.h" in text
    )
    exec(compile(python, "page", "exec"), names)
    Path("tip.cpp").write_text(program, encoding="utf-8")
    subprocess.run(["c++", "tip.cpp", "tip_model.c", "-o", "tip"], check=True)
    printed = subprocess.run(["./tip"], check=True, capture_output=True, text=True).stdout.split()
    model, expected = names["model"], []
    state = model.at_rest(29.0, 0.0)[None]
    for k in range(50):
        theta, state = model.advance(state, np.array([[0.04 * k]]))
        expected.append(float(theta[0, 0]))
    assert [float(word) for word in printed] == pytest.approx(expected, abs=1e-8)


SHELL = re.compile(r"^```(?:sh|bash)?\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(?:hystmpc|make|pip|python|ros2|colcon) ")
SET = {"$PWD", "$HOME"}  # variables that every shell has


def unpasteable(text: str) -> list[str]:
    """Commands of a page with a comment, which zsh takes for words, or a variable that no shell has set."""
    lines = [line for block in SHELL.findall(text) for line in block.splitlines() if COMMAND.match(line)]
    return [line for line in lines if re.search(r"\s#", line) or set(re.findall(r"\$\w+", line)) - SET]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_can_be_pasted_into_any_shell(page: Path) -> None:
    assert unpasteable(page.read_text(encoding="utf-8")) == []


def test_a_command_that_cannot_be_pasted_is_found() -> None:
    assert unpasteable("```sh\nhystmpc check a.csv  # why?\nhystmpc fit pi $LOGS\nmake test\n```\n") == [
        "hystmpc check a.csv  # why?",
        "hystmpc fit pi $LOGS",
    ]
