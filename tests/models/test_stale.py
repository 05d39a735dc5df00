"""Compiled code of another source than the one that is there is never used."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

NJIT = "from hystmpc.models.kernels.numba_ import njit\n"
FILES = {
    "__init__.py": "",
    "numbers_.py": "GRAVITY = 9.81\n",
    "inner.py": NJIT
    + "from .numbers_ import GRAVITY\n\n@njit(cache=True)\ndef inner(x):\n    return x * GRAVITY + OFFSET\n\n"
    + "OFFSET = 1.0\n",
    "outer.py": NJIT + "from .inner import inner\n\n@njit(cache=True)\ndef outer(x):\n    return inner(x)\n",
    "alone.py": NJIT + "\n@njit(cache=True)\ndef alone(x):\n    return x\n",
}
KERNELS = ("alone", "inner", "outer")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of kernels."""
    folder = tmp_path / "some_kernels"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    forget()


def forget() -> None:
    for name in [name for name in sys.modules if name.startswith("some_kernels")]:
        del sys.modules[name]


def started(folder: Path) -> tuple[list[str], float]:
    """Kernels that a new process would compile, and what the outer one answers."""
    forget()
    importlib.invalidate_caches()
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        kernels = {name: getattr(importlib.import_module(f"some_kernels.{name}"), name) for name in KERNELS}
    finally:
        sys.dont_write_bytecode = before
    answers = {name: kernel(2.0) for name, kernel in kernels.items()}
    assert answers["inner"] == answers["outer"]
    return [name for name, kernel in kernels.items() if not kernel.stats.cache_hits], answers["outer"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "text", "anew", "answer"),
    [
        (None, "", [], 20.62),
        ("alone.py", "# one more line\n", ["alone"], 20.62),
        ("outer.py", "# one more line\n", ["outer"], 20.62),
        ("inner.py", "OFFSET = 2.0\n", ["inner", "outer"], 21.62),  # a kernel that another one calls
        ("numbers_.py", "GRAVITY = 1.0\n", ["inner", "outer"], 3.0),  # a constant of another file
        ("numbers_.py", "FURTHER = 1.0\n", [], 20.62),  # nobody reads it
    ],
)
def test_what_has_changed_is_compiled_anew_and_kept(
    changed: str | None, text: str, anew: list[str], answer: float, folder: Path
) -> None:
    assert started(folder) == (list(KERNELS), 20.62)
    if changed is not None:
        with (folder / changed).open("a") as file:
            file.write(text)
    assert started(folder) == (anew, pytest.approx(answer))
    assert started(folder) == ([], pytest.approx(answer))


def test_the_same_source_in_a_younger_file_is_not_compiled_again(folder: Path) -> None:
    assert started(folder)[0] == list(KERNELS)
    for name, text in FILES.items():
        (folder / name).unlink()
        (folder / name).write_text(text)
    assert started(folder)[0] == []


def test_data_that_another_process_wrote_for_another_source_is_not_loaded(folder: Path) -> None:
    """Index and data of one file are two files: between them another process may have written its own."""
    assert started(folder)[0] == list(KERNELS)
    compiled = Path(importlib.import_module("some_kernels.inner").inner._cache.cache_path)
    index, data = (next(compiled.glob(f"inner.*.{ending}")) for ending in ("nbi", "nbc"))
    before = index.read_bytes()
    (folder / "numbers_.py").write_text("GRAVITY = 1.0\n")
    assert started(folder)[1] == pytest.approx(3.0)
    assert data.exists()
    (folder / "numbers_.py").write_text(FILES["numbers_.py"])
    index.write_bytes(before)
    assert started(folder)[1] == pytest.approx(20.62)
