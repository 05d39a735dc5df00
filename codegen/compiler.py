"""Compilation of exported sources into shared libraries, by the compiler that the engine is built with."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from hystmpc.core import build
from hystmpc.core.build import EXPECTED, zig
from hystmpc.trials.errors import ExportError

__all__ = ["EXPECTED", "compiler", "shared_library", "zig"]

_FLAGS = ("-std=c99", "-ffp-contract=off", "-shared")  # a contracted product and sum would differ in the last digit


def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler, see `EXPECTED`; None if there is no compiler.

    Raises:
        ExportError: if CC names no program.
    """
    try:
        return build.compiler()
    except RuntimeError as error:
        raise ExportError(str(error)) from None


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
        words = [*_FLAGS, *flags, "-o", "library", *mains, "-lm"]
        try:
            build.run(command, words, Path(folder))
        except RuntimeError as error:
            raise ExportError(str(error)) from None
        return (Path(folder) / "library").read_bytes()
