"""Exported controllers as libraries, by the C compiler of the machine, else by that of the wheel `ziglang`."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.codegen import ControllerExport, export_controller

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
SOURCES = ("mpc", "feedback", "shifted plan", "inverse", "hold", "stop")


def compilers(language: str = "cc") -> list[list[str]]:
    """Commands of the compilers that there are, for C ("cc") or C++ ("c++"); the wheel's makes its library first."""
    own, found = shutil.which(language), importlib.util.find_spec("ziglang")
    return [*([[own]] if own else []), *([[sys.executable, "-m", "ziglang", language]] if found else [])]


def tried(command: Sequence[str], folder: Path) -> str:
    """What a compiler says that fails in a folder; empty where it does not."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    return "" if done.returncode == 0 else done.stderr or "failed"


def compile_c(arguments: Sequence[str], folder: Path, language: str = "cc") -> None:
    """Run a compiler in a folder; what it says is in the failure. The test is skipped where there is none."""
    known = compilers(language)
    if not known:
        pytest.skip(f"no compiler: neither {language} nor the package ziglang")
    assert tried([*known[0], *arguments], folder) == ""


class Library:
    """A compiled controller: `init`, `step`, `set_target` and `stop` on memory of its own."""

    def __init__(self, export: ControllerExport, folder: Path, single: bool = False, level: str = "-O1") -> None:
        export.write(folder)
        compile_c([*STRICT, level, "-fPIC", "-shared", "-o", "controller.so", "hystmpc.c", "-lm"], folder)
        real: Any = ctypes.c_float if single else ctypes.c_double

        class Command(ctypes.Structure):
            _fields_ = [
                *((name, real) for name in ("u", "predicted_deg", "departure_deg")),
                *((name, ctypes.c_int) for name in ("source", "status", "missing")),
            ]

        self._library = ctypes.CDLL(str(folder / "controller.so"))
        self._library.hystmpc_init.argtypes = [ctypes.c_void_p, real, real]
        self._library.hystmpc_set_target.argtypes = [ctypes.c_void_p, real]
        self._library.hystmpc_stop.argtypes = [ctypes.c_void_p]
        self._library.hystmpc_step.argtypes = [ctypes.c_void_p, real, ctypes.c_void_p]
        self._library.hystmpc_step.restype = Command
        self._library.hystmpc_memory_bytes.restype = ctypes.c_ulong
        self.memory_bytes = int(self._library.hystmpc_memory_bytes())
        self.memory = ctypes.create_string_buffer(self.memory_bytes)
        self._vector = real * export.reference_samples

    def init(self, angle: float, command: float) -> int:
        return int(self._library.hystmpc_init(self.memory, angle, command))

    def vector(self, reference: Any) -> Any:
        """A reference as `step` takes it."""
        return self._vector(*np.asarray(reference).tolist())

    def step(self, angle: float, reference: Any = None) -> Any:
        return self._library.hystmpc_step(self.memory, angle, reference)

    def set_target(self, angle: float) -> None:
        self._library.hystmpc_set_target(self.memory, angle)

    def stop(self) -> None:
        self._library.hystmpc_stop(self.memory)


def library(settings: Mapping[str, Any], folder: Path, single: bool = False) -> Library:
    """The controller of `settings`, compiled in a folder."""
    return Library(export_controller(settings, single=single, folder=EXAMPLES), folder, single)
