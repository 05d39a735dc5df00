"""Compilation of the engine's C files, once, when the package is built. Needs the standard library alone.

The whole engine is compiled once for each level of vector instructions (`LEVELS`): the same text gives the same numbers
at every level, and `library.py` loads the best one that the processor has.
"""

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
from collections.abc import Sequence
from pathlib import Path

EXPECTED = "a command in the variable CC, the program cc, the package ziglang (pip install ziglang)"
"""Where a compiler is looked for, in this order."""

FLAGS = (
    "-std=c99",
    "-O3",
    "-fPIC",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fvisibility=hidden",
    "-shared",
)
"""A contracted product and sum would differ in the last digit between machines."""

_V3 = ("-mavx2", "-mfma", "-mbmi", "-mbmi2", "-mf16c", "-mlzcnt", "-mmovbe")
_V4 = (*_V3, "-mavx512f", "-mavx512bw", "-mavx512cd", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=512")
LEVELS = {"v4": _V4, "v3": _V3, "plain": ()}
"""Vector instructions of a library and the compiler's flags, best first; processors other than x86-64 have `plain`."""

_LONGEST_S = 600.0  # ziglang makes its C library first


def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler, see `EXPECTED`; None if there is no compiler.

    Raises:
        RuntimeError: if CC names no program.
    """
    named = tuple(shlex.split(os.environ.get("CC", "")))
    if named and shutil.which(named[0]) is None:
        raise RuntimeError(f"got CC={named[0]}, which is no program, expected a C compiler")
    cc = shutil.which("cc")
    return named or ((cc,) if cc else zig())


def zig(*arguments: str) -> tuple[str, ...] | None:
    """Return the command of the compiler in the package `ziglang`; None if the package is not installed."""
    if importlib.util.find_spec("ziglang") is None:
        return None
    return (sys.executable, "-P", "-m", "ziglang", "cc", *arguments)  # nothing of a working folder is imported


def sources(folder: Path) -> list[Path]:
    """C files of the engine in the order of compilation, and its headers."""
    return sorted([*folder.glob("*.c"), *folder.glob("*.h")])


def digest(folder: Path) -> str:
    """Name of the present state of all C files."""
    text = b"\0".join(part for file in sources(folder) for part in (file.name.encode(), file.read_bytes()))
    return hashlib.sha256(text).hexdigest()[:16]


def suffix(target: str = sys.platform) -> str:
    """Ending of a shared library's name."""
    return {"win32": ".dll", "darwin": ".dylib"}.get(target, ".so")


def levels(machine: str | None = None) -> tuple[str, ...]:
    """Levels that are compiled for a processor, best first; this machine's where left out."""
    x86 = (machine or platform.machine()).lower() in ("x86_64", "amd64")
    return tuple(LEVELS) if x86 else ("plain",)


def file_name(level: str, target: str = sys.platform) -> str:
    """Name of the library of a level."""
    return f"hystmpc_{level}{suffix(target)}"


def build(folder: Path, destination: Path, command: Sequence[str] | None = None) -> list[Path]:
    """Compile the C files in a folder into one shared library a level; returns their paths.

    Args:
        folder: with the C files.
        destination: of the libraries; each is complete or not there.
        command: of the compiler, with a target for another machine; found by `compiler` where left out.

    Raises:
        RuntimeError: if there is no compiler, or it fails; with its first error message.
    """
    command = command or compiler()
    if command is None:
        raise RuntimeError(f"got no C compiler, expected one of: {EXPECTED}")
    destination.mkdir(parents=True, exist_ok=True)
    return [_library(folder, destination, command, level) for level in levels()]


def _library(folder: Path, destination: Path, command: Sequence[str], level: str) -> Path:
    files = [file.name for file in sources(folder) if file.suffix == ".c"]
    stamp = f'-DHYSTMPC_DIGEST="{digest(folder)}"'
    with tempfile.TemporaryDirectory(dir=destination, prefix=".building-") as scratch:
        made = Path(scratch).resolve() / file_name(level)
        words = [*command, *FLAGS, *LEVELS[level], stamp, "-o", str(made), *files, "-lm"]
        try:
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RuntimeError(f"the C compiler {shlex.join(command)} cannot run: {error}") from None
        if done.returncode != 0:
            said = [line for line in done.stderr.splitlines() if "error" in line] or [done.stderr.strip()[:200]]
            raise RuntimeError(f"the C compiler {shlex.join(command)} fails: {said[0].strip() or 'it says nothing'}")
        os.replace(made, destination / made.name)
    return destination / file_name(level)
