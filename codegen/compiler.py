"""C compiler (of this machine, or of the package `ziglang`) and compilation of shared libraries."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from hystmpc.trials.errors import ExportError

EXPECTED = "a command in the variable CC, the program cc, the package ziglang (pip install ziglang)"
"""Where a compiler is looked for, in this order."""

_FLAGS = ("-std=c99", "-ffp-contract=off", "-shared")  # a contracted product and sum would differ in the last digit
_LONGEST_S = 600.0  # ziglang makes its C library first


def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler, see `EXPECTED`; None if there is no compiler.

    Raises:
        ExportError: if CC names no program.
    """
    named = tuple(shlex.split(os.environ.get("CC", "")))
    if named and shutil.which(named[0]) is None:
        raise ExportError(f"got CC={named[0]}, which is no program, expected a C compiler")
    cc = shutil.which("cc")
    return named or ((cc,) if cc else zig())


def zig(*arguments: str) -> tuple[str, ...] | None:
    """Return the command of the compiler in the package `ziglang`; None if the package is not installed."""
    if importlib.util.find_spec("ziglang") is None:
        return None
    return (sys.executable, "-P", "-m", "ziglang", "cc", *arguments)  # nothing of a working folder is imported


def shared_library(command: Sequence[str], flags: Sequence[str], sources: Mapping[str, str], *mains: str) -> bytes:
    """Compile C sources into a shared library and return its bytes.

    Args:
        flags: in addition to those for C99 and for a shared library.
        sources: text of each file, by its name.
        mains: the files that are compiled; the others are headers.

    Raises:
        ExportError: if the compiler cannot run or fails, with its first error message.
    """
    with tempfile.TemporaryDirectory(prefix="hystmpc-c-") as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        words = [*command, *_FLAGS, *flags, "-o", "library", *mains, "-lm"]
        try:
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"the C compiler {shlex.join(command)} cannot run: {error}") from None
        if done.returncode != 0:
            said = [line for line in done.stderr.splitlines() if "error" in line] or [done.stderr.strip()[:200]]
            raise ExportError(f"the C compiler {shlex.join(command)} fails: {said[0].strip() or 'it says nothing'}")
        return (Path(folder) / "library").read_bytes()
