"""An exported controller as a shared library for this machine and this process."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

from hystmpc.trials.errors import ExportError

from .compiler import EXPECTED, compiler, shared_library
from .controller import ControllerExport

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC")
"""For speed on this machine. With `-ffp-contract=off` of `shared_library` they leave every number as it is."""

_made: dict[tuple[str, str, str], Path] = {}


def controller_library(export: ControllerExport, beside: str = "") -> Path:
    """The compiled controller, in a folder that is this process's own and ends with it.

    No library that an earlier program has left is ever loaded: what moves a device was compiled by the process that
    moves it.

    Args:
        beside: a file of C that is compiled with it; it finds the header as hystmpc.h.

    Raises:
        ExportError: if there is no compiler, or it fails; with the first thing that it says.
        OSError: if there is no place for a temporary file.
    """
    text = export.header, export.source, beside
    if text not in _made:
        library = _compiled(export, beside)
        handle, name = tempfile.mkstemp(prefix="hystmpc_controller_", suffix=".so", dir=_folder())
        with os.fdopen(handle, "wb") as file:  # a new one each time: a file that is loaded is never written again
            file.write(library)
        _made[text] = Path(name)
    return _made[text]


@cache
def _folder() -> Path:
    """A new folder that no other user may enter."""
    folder = tempfile.mkdtemp(prefix="hystmpc-controller-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _compiled(export: ControllerExport, beside: str) -> bytes:
    command = compiler()
    if command is None:
        raise ExportError(f"got no C compiler, expected one of: {EXPECTED}")
    sources = {"hystmpc.h": export.header, "hystmpc.c": export.source, "beside.c": beside}
    mains = ("hystmpc.c", "beside.c") if beside else ("hystmpc.c",)
    return shared_library(command, FLAGS, sources, *mains)
