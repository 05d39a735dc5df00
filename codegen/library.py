"""Compilation of an exported controller for this machine, and its calls through ctypes."""

from __future__ import annotations

import atexit
import ctypes
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, final

from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Vec

from .compiler import EXPECTED, compiler, shared_library
from .controller import ControllerExport

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC")
"""For speed on this machine. With `-ffp-contract=off` of `shared_library` they leave every number as it is."""

_REAL = ctypes.c_double
_made: dict[tuple[str, str, str], Path] = {}


def controller_library(export: ControllerExport, companion_c: str = "") -> Path:
    """Compile a controller into a shared library in a temporary folder of this process.

    A library of an earlier process is never loaded: only code compiled by this process moves the device.

    Args:
        companion_c: additional C file, compiled with it; includes the header as hystmpc.h.

    Raises:
        ExportError: if there is no compiler, or it fails; with its first message.
        OSError: if there is no place for a temporary file.
    """
    text = export.header, export.source, companion_c
    if text not in _made:
        library = _compiled(export, companion_c)
        handle, name = tempfile.mkstemp(prefix="hystmpc_controller_", suffix=".so", dir=_folder())
        with os.fdopen(handle, "wb") as file:  # a new one each time: a file that is loaded is never written again
            file.write(library)
        _made[text] = Path(name)
    return _made[text]


@cache
def _folder() -> Path:
    """Create a new folder that only the present user can access."""
    folder = tempfile.mkdtemp(prefix="hystmpc-controller-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _compiled(export: ControllerExport, companion_c: str) -> bytes:
    command = compiler()
    if command is None:
        raise ExportError(f"got no C compiler, expected one of: {EXPECTED}")
    sources = {"hystmpc.h": export.header, "hystmpc.c": export.source, "companion.c": companion_c}
    mains = ("hystmpc.c", "companion.c") if companion_c else ("hystmpc.c",)
    return shared_library(command, FLAGS, sources, *mains)


@final
class LoadedController:
    """Exported controller in double precision, with one memory for its state.

    A step keeps the interpreter's lock: another thread that took it would delay the loop by more than the step lasts.
    `init` and `look_on`, for which no loop waits, release it.

    Raises:
        OSError: if the file is no library of this machine.
    """

    def __init__(self, export: ControllerExport, library: Path) -> None:
        kind, kind_of_answer = (export.structs[f"hystmpc_{name}"] for name in ("controller", "command"))
        functions, patient = ctypes.PyDLL(str(library)), ctypes.CDLL(str(library))
        self._init, self._step, self._look_on = patient.hystmpc_init, functions.hystmpc_step, patient.hystmpc_look_on
        self._stop, self._hurry = functions.hystmpc_stop, functions.hystmpc_hurry
        for function in (self._init, self._look_on):
            function.argtypes = [ctypes.c_void_p, _REAL, _REAL]
        for function in (self._stop, self._hurry):
            function.argtypes, function.restype = [ctypes.c_void_p], None
        self._step.argtypes, self._step.restype = [ctypes.c_void_p, _REAL, ctypes.c_void_p], kind_of_answer
        self.view: Any = kind()
        """The struct `hystmpc_controller` of the header."""
        self.address = self._at = ctypes.addressof(self.view)
        self._size = int(kind.work.offset)

    @property
    def memory(self) -> bytes:
        """Snapshot of the controller's state as bytes."""
        return ctypes.string_at(self._at, self._size)

    def remember(self, memory: bytes) -> None:
        """Restore a snapshot of the controller's state."""
        if len(memory) != self._size:
            raise ValueError(f"memory: got {len(memory)} bytes, expected {self._size}")
        ctypes.memmove(self._at, memory, self._size)

    def init(self, angle_deg: float, command: float) -> int:
        """Start at rest; returns 0, or the code of the error that prevents the start."""
        return int(self._init(self._at, angle_deg, command))

    def look_on(self, angle_deg: float, command: float) -> int:
        """Update the state with a command of another source; returns the number of samples of failed model steps."""
        return int(self._look_on(self._at, angle_deg, command))

    def step(self, angle_deg: float, reference: Vec) -> Any:
        """Compute the command as the struct `hystmpc_command` of the header; `reference` (N,) has to be contiguous."""
        return self._step(self._at, angle_deg, reference.ctypes.data)

    def hold(self, command: float) -> None:
        """Set the command that the device holds, in place of the one sent last."""
        for name in ("estimate", "plain"):
            if hasattr(self.view, name):
                getattr(self.view, name).command = command

    def hurry(self) -> None:
        """Skip planning in the next step."""
        self._hurry(self._at)

    def stop(self) -> None:
        """Latch the stop."""
        self._stop(self._at)
