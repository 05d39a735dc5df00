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

PROGRAM = "sanitized.c"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
OPERATORS, NETWORK = ("-O0",), ("-O0", "-march=native")
"""Options where numbers are compared: a third of the time of a compilation that optimises."""
FAST = ("-O3", "-march=native")
"""As a lab compiles a network: loops are vectors, and fused multiply-adds are instructions."""
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


def run_sanitized(
    export: ControllerExport, folder: Path, steps: int = 3000, program: str = PROGRAM, more: Sequence[str] = ()
) -> None:
    """Steps under the sanitizers; where that for addresses has no library, undefined behaviour alone, which traps."""
    export.write(folder)
    text = Path(__file__).with_name(program).read_text(encoding="utf-8")
    (folder / "main.c").write_text(text, encoding="utf-8")
    files = ["main.c"] if '#include "hystmpc.c"' in text else ["main.c", "hystmpc.c"]
    both = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    traps = ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]
    # With -Og a run takes a third of the time of -O0, and its compilation little more than with -O0.
    here = f"-I{Path(__file__).parent}"
    build = [*STRICT, f"-DSTEPS={steps}", *more, here, "-Og", "-g1", "-o", "run", *files, "-lm"]
    if not compilers() or tried([*compilers()[0], *both, *build], folder):
        compile_c([*traps, *build], folder)
    done = subprocess.run([folder / "run"], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, f"{steps} steps\n"), done.stderr


class Library:
    """A compiled controller: the functions of its header on memory of its own; of two axes with arrays."""

    def __init__(
        self, export: ControllerExport, folder: Path, single: bool = False, options: Sequence[str] | None = None
    ) -> None:
        export.write(folder)
        options = options or (NETWORK if "fmaf" in export.functions else OPERATORS)
        compile_c([*STRICT, *options, "-fPIC", "-shared", "-o", "controller.so", "hystmpc.c", "-lm"], folder)
        real: Any = ctypes.c_float if single else ctypes.c_double
        two, self._array = export.axes > 1, real
        each: Any = ctypes.c_int * 2 if two else ctypes.c_int
        angles, commands = (real * export.axes, real * export.commands) if two else (real, real)
        given: Any = ctypes.c_void_p if two else real
        self._given = self._as_array if two else float

        class Command(ctypes.Structure):
            _fields_ = [
                *(("u", commands), ("predicted_deg", angles), ("departure_deg", angles), ("source", ctypes.c_int)),
                *(("status", each), ("fault", each), ("missing", each), ("planned", ctypes.c_int), ("inverse", each)),
            ]

        self._library = ctypes.CDLL(str(folder / "controller.so"))
        self._library.hystmpc_init.argtypes = [ctypes.c_void_p, given, given]
        self._library.hystmpc_set_target.argtypes = [ctypes.c_void_p, given]
        self._library.hystmpc_stop.argtypes = [ctypes.c_void_p]
        self._library.hystmpc_hurry.argtypes = [ctypes.c_void_p]
        self._library.hystmpc_look_on.argtypes = [ctypes.c_void_p, given, given]
        self._library.hystmpc_measure.argtypes = [ctypes.c_void_p, given, real]
        if not two:
            self._library.hystmpc_input.argtypes = [ctypes.c_void_p, ctypes.c_int, real]
        self._library.hystmpc_step.argtypes = [ctypes.c_void_p, given, ctypes.c_void_p]
        self._library.hystmpc_step.restype = Command
        self._library.hystmpc_memory_bytes.restype = ctypes.c_ulong
        self.memory_bytes = int(self._library.hystmpc_memory_bytes())
        self.memory = ctypes.create_string_buffer(self.memory_bytes)
        self._vector = real * (export.reference_samples * export.axes)

    def _as_array(self, numbers: Any) -> Any:
        return (self._array * len(numbers))(*numbers)

    def init(self, angle: Any, command: Any) -> int:
        return int(self._library.hystmpc_init(self.memory, self._given(angle), self._given(command)))

    def vector(self, reference: Any) -> Any:
        """A reference as `step` takes it."""
        return self._vector(*np.asarray(reference).ravel().tolist())

    def step(self, angle: Any, reference: Any = None) -> Any:
        return self._library.hystmpc_step(self.memory, self._given(angle), reference)

    def set_target(self, angle: Any) -> None:
        self._library.hystmpc_set_target(self.memory, self._given(angle))

    def look_on(self, angle: Any, command: Any) -> int:
        return int(self._library.hystmpc_look_on(self.memory, self._given(angle), self._given(command)))

    def measure(self, angle: Any, age: float) -> int:
        return int(self._library.hystmpc_measure(self.memory, self._given(angle), age))

    def input(self, number: int, value: float) -> int:
        return int(self._library.hystmpc_input(self.memory, number, value))

    def hurry(self) -> None:
        self._library.hystmpc_hurry(self.memory)

    def stop(self) -> None:
        self._library.hystmpc_stop(self.memory)


def library(
    settings: Mapping[str, Any], folder: Path, single: bool = False, options: Sequence[str] | None = None
) -> Library:
    """The controller of `settings`, compiled in a folder."""
    return Library(export_controller(settings, single=single, folder=EXAMPLES), folder, single, options)
