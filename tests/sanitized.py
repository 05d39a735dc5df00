"""C programs of the tests under the compiler's sanitizers."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from hystmpc.core.build import compiler
from hystmpc.core.library import FOLDER

_WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
_BOTH = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_TRAPS = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")


def said_under_sanitizers(program: Path, engine: Sequence[str], words: Sequence[object], folder: Path) -> str:
    """What a program says that is compiled with some of the engine's files; it must not fail.

    Where the sanitizer for addresses has no library, undefined behaviour alone is watched, which traps.
    """
    command = compiler()
    if command is None:
        pytest.skip("no compiler")
    sources = [str(program), *(str(FOLDER / name) for name in engine)]
    build = [*command, *_WARNINGS, "-g", "-I", str(FOLDER), "-o", str(folder / "run"), *sources, "-lm"]
    if subprocess.run([*build, *_BOTH], capture_output=True, timeout=600, check=False).returncode:
        subprocess.run([*build, *_TRAPS], check=True, timeout=600)
    run = [str(folder / "run"), *(str(word) for word in words)]
    done = subprocess.run(run, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout
