"""The wheel, installed alone and without extras; run by `make wheel-test` from a folder outside the checkout."""

from __future__ import annotations

import importlib.util
import os
import pkgutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

CHECKOUT = os.environ.get("HYSTMPC_CHECKOUT", "")
WHEEL = os.environ.get("HYSTMPC_WHEEL", "")
ROOMS = (
    "core",
    "trials",
    "models",
    "trajectories",
    "ctrl",
    "sim",
    "rig",
    "codegen",
    "gap",
    "testing",
    "bench",
    "tasks",
    "cli",
)
# These wrap packages of an extra, and may ask for it when they are imported.
EXTRAS = {
    "torch",
    "mcap",
    "h5py",
    "rosbags",
    "distributed",
    "gymnasium",
    "optuna",
    "cyclonedds",
}

pytestmark = pytest.mark.skipif(not WHEEL, reason="no wheel is installed here: run `make wheel-test`")


def wheel_files() -> set[str]:
    """Names in the wheel, its metadata left out."""
    with zipfile.ZipFile(WHEEL) as archive:
        return {name for name in archive.namelist() if not name.partition("/")[0].endswith(".dist-info")}


def modules() -> list[str]:
    """Every module of the installed package."""
    import hystmpc

    names = [info.name for info in pkgutil.walk_packages(hystmpc.__path__, "hystmpc.")]
    return [name for name in names if not name.startswith("hystmpc.core.hystmpc_")]  # the engine is no module of Python


def test_wheel_holds_the_rooms_and_nothing_else() -> None:
    rooms = [path for room in ROOMS for path in Path(CHECKOUT, room).rglob("*")]
    expected = {
        f"hystmpc/{path.relative_to(CHECKOUT).as_posix()}"
        for path in rooms
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".building")
    }
    assert wheel_files() == expected | {"hystmpc/__init__.py", "hystmpc/py.typed"}


def test_extras_are_absent() -> None:
    """Otherwise the tests below would not show that the core does without them."""
    assert [name for name in EXTRAS if importlib.util.find_spec(name)] == []


@pytest.mark.parametrize("name", modules() if WHEEL else [])
def test_module_imports(name: str) -> None:
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        wrapper = name.endswith("_") or name.startswith("hystmpc.models.train.")
        if not wrapper or error.name not in EXTRAS:
            raise
    else:
        assert Path(str(module.__file__)).is_relative_to(sys.prefix)


def test_command_line_answers() -> None:
    done = subprocess.run([Path(sys.prefix, "bin", "hystmpc"), "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout


def test_an_fmu_holds_binaries_for_other_machines(tmp_path: Path) -> None:
    """Made by ziglang, whose first binary for Windows takes over a minute: it compiles its C library for it."""
    pytest.importorskip("ziglang", reason="`make wheel-test` installs it")
    platforms = [f"--platform={name}" for name in ("linux64", "win64", "darwin64")]
    command = [Path(sys.prefix, "bin", "hystmpc"), "export-fmu", "builtin:pi", "--fmi=3.0", "--out=pi.fmu", *platforms]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "pi.fmu") as fmu:
        paths = [name for name in fmu.namelist() if name.startswith("binaries/")]
        heads = {path.split("/")[1]: fmu.read(path)[:4] for path in paths}
    assert heads["x86_64-linux"] == b"\x7fELF"
    assert heads["x86_64-windows"][:2] == b"MZ"
    assert heads["x86_64-darwin"] == bytes.fromhex("cffaedfe")
