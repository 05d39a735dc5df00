"""Compiled code that is older than what went into it is not used again."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

import pytest

from hystmpc.models.inverse.follow import follow_source
from hystmpc.models.kernels.stale import drop_stale_kernels

FILES = {
    "sim/__init__.py": "",
    "sim/outer.py": "from numba import njit\nfrom .inner import inner\nfrom ..trials.errors import SomeError\n",
    "sim/inner.py": "from numba import njit\nfrom hystmpc.models.numbers import GRAVITY\n",
    "sim/alone.py": "from numba import njit\n",
    "models/__init__.py": "",
    "models/numbers.py": "GRAVITY = 9.81\n",
    "trials/errors.py": "class SomeError(Exception): ...\n",
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A package whose kernels were all compiled after its files were written."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        os.utime(path, (1000, 1000))
    for name in ("outer", "inner", "alone"):
        compiled = tmp_path / "sim" / "__pycache__" / f"{name}.kernel-3.py311.1.nbc"
        compiled.parent.mkdir(exist_ok=True)
        compiled.touch()
        os.utime(compiled, (2000, 2000))
    return tmp_path


@pytest.mark.parametrize(
    ("changed", "gone"),
    [
        (None, []),
        ("sim/alone.py", ["alone"]),
        ("sim/outer.py", ["outer"]),
        ("sim/inner.py", ["inner", "outer"]),  # a kernel that another one calls
        ("models/numbers.py", ["inner", "outer"]),  # a constant, by way of another file
        ("trials/errors.py", []),  # never compiled
    ],
)
def test_what_an_imported_file_has_changed_is_compiled_anew(root: Path, changed: str | None, gone: list[str]) -> None:
    if changed is not None:
        os.utime(root / changed, (3000, 3000))
    assert [path.name.partition(".")[0] for path in drop_stale_kernels(root)] == gone
    assert sum(1 for _ in root.rglob("*.nbc")) == 3 - len(gone)
    assert drop_stale_kernels(root) == []


def test_the_code_of_a_file_that_is_gone_goes_too(root: Path) -> None:
    (root / "sim" / "alone.py").unlink()
    assert [path.name.partition(".")[0] for path in drop_stale_kernels(root)] == ["alone"]


@pytest.mark.parametrize(("network", "other"), [("hystmpc.models.kernels.lstm_kernels", True), ("generated", False)])
def test_a_changed_kernel_of_the_package_is_another_follower(tmp_path: Path, network: str, other: bool) -> None:
    for file in resources.files("hystmpc.models.kernels").iterdir():
        if file.name.endswith(".py"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
    before = follow_source("chain", network, tmp_path)
    with (tmp_path / "lstm_gates.py").open("a", encoding="utf-8") as file:
        file.write("# one more line\n")
    assert (follow_source("chain", network, tmp_path) != before) == other
