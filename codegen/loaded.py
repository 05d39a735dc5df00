"""A compiled controller in this process: its functions and its memory, through ctypes."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, final

from hystmpc.trials.types import Vec

from .controller import ControllerExport

_REAL = ctypes.c_double


@final
class LoadedController:
    """The functions of an exported controller, in double precision, on one memory.

    `memory` is what is remembered from step to step, as bytes: a snapshot, which `remember` takes up again. A step
    keeps the interpreter's lock: another thread that took it meanwhile would keep the loop waiting for longer than the
    step lasts. `init` and `look_on`, which no loop waits for, leave it to others.

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
        """What is remembered now."""
        return ctypes.string_at(self._at, self._size)

    def remember(self, memory: bytes) -> None:
        """Be as at the moment of `memory`."""
        if len(memory) != self._size:
            raise ValueError(f"memory: got {len(memory)} bytes, expected {self._size}")
        ctypes.memmove(self._at, memory, self._size)

    def init(self, angle_deg: float, command: float) -> int:
        """At rest; 0, or why it cannot start."""
        return int(self._init(self._at, angle_deg, command))

    def look_on(self, angle_deg: float, command: float) -> int:
        """A sample in which another has sent `command`; for how many samples the model has failed."""
        return int(self._look_on(self._at, angle_deg, command))

    def step(self, angle_deg: float, reference: Vec) -> Any:
        """The struct `hystmpc_command` of the header; `reference` is contiguous and as long as it says."""
        return self._step(self._at, angle_deg, reference.ctypes.data)

    def hold(self, command: float) -> None:
        """The device holds `command`, whatever was sent last."""
        for name in ("estimate", "plain"):
            if hasattr(self.view, name):
                getattr(self.view, name).command = command

    def hurry(self) -> None:
        """The next step makes no plan."""
        self._hurry(self._at)

    def stop(self) -> None:
        """Latch the stop."""
        self._stop(self._at)
