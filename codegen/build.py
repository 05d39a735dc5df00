"""An exported controller as a shared library: a compiler found, its work kept in the user's cache."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from hystmpc.models.kernels.numba_ import cache_folder
from hystmpc.trials.errors import ExportError
from hystmpc.trials.files import write_atomically

from .controller import ControllerExport

_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
_MOST_S = 300.0


def compiler() -> tuple[str, ...]:
    """The command of the C compiler: that of the variable CC, else `cc`, else that of the package `ziglang`.

    Raises:
        ExportError: if there is none.
    """
    named = tuple(shlex.split(os.environ.get("CC", "")))
    if named:
        if shutil.which(named[0]) is None:
            raise ExportError(f"got CC={named[0]}, which is no program, expected a C compiler")
        return named
    if own := shutil.which("cc"):
        return (own,)
    if importlib.util.find_spec("ziglang") is not None:
        return (sys.executable, "-m", "ziglang", "cc")
    raise ExportError(
        "got no C compiler, expected one of: a command in the variable CC, the program cc, the package ziglang "
        "(pip install ziglang)"
    )


def shared_library(export: ControllerExport) -> Path:
    """The compiled controller; the same source is compiled once for a user and a kind of machine.

    Raises:
        ExportError: if there is no compiler, or it fails; with the first thing that it says.
    """
    kind = (*_FLAGS, sys.platform, platform.machine(), export.header, export.source)
    digest = hashlib.sha256("\n".join(kind).encode()).hexdigest()[:24]
    path = cache_folder() / f"hystmpc_controller_{digest}.so"
    return path if path.is_file() else write_atomically(path, _compiled(export, compiler()))


def _compiled(export: ControllerExport, command: tuple[str, ...]) -> bytes:
    """The bytes of the library."""
    with tempfile.TemporaryDirectory(prefix="hystmpc-c-") as scratch:
        export.write(Path(scratch))
        words = [*command, *_FLAGS, "-o", "controller.so", "hystmpc.c", "-lm"]
        try:
            done = subprocess.run(words, cwd=scratch, capture_output=True, text=True, timeout=_MOST_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"the C compiler {shlex.join(command)} fails: {error}") from None
        if done.returncode != 0:
            said = [line for line in done.stderr.splitlines() if "error" in line] or ["it says nothing"]
            raise ExportError(f"the C compiler {shlex.join(command)} fails: {said[0].strip()}")
        return (Path(scratch) / "controller.so").read_bytes()
