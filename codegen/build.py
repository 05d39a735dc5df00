"""An exported controller as a shared library for this machine, kept in the user's cache."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

from hystmpc.models.kernels.numba_ import cache_folder
from hystmpc.trials.errors import ExportError
from hystmpc.trials.files import write_atomically

from .compiler import EXPECTED, compiler, shared_library
from .controller import ControllerExport

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC")
"""For speed on this machine. With `-ffp-contract=off` of `shared_library` they leave every number as it is."""


def controller_library(export: ControllerExport, beside: str = "") -> Path:
    """The compiled controller; the same source is compiled once for a user and a kind of processor.

    Args:
        beside: a file of C that is compiled with it; it finds the header as hystmpc.h.

    Raises:
        ExportError: if there is no compiler, or it fails; with the first thing that it says.
    """
    kind = (*FLAGS, sys.platform, get_host_cpu_name(), export.header, export.source, beside)
    digest = hashlib.sha256("\n".join(kind).encode()).hexdigest()[:24]
    path = cache_folder() / f"hystmpc_controller_{digest}.so"
    return path if path.is_file() else write_atomically(path, _compiled(export, beside))


def _compiled(export: ControllerExport, beside: str) -> bytes:
    command = compiler()
    if command is None:
        raise ExportError(f"got no C compiler, expected one of: {EXPECTED}")
    sources = {"hystmpc.h": export.header, "hystmpc.c": export.source, "beside.c": beside}
    mains = ("hystmpc.c", "beside.c") if beside else ("hystmpc.c",)
    return shared_library(command, FLAGS, sources, *mains)
