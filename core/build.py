"""Compilation of the engine's C files, once, when the package is built. Needs no other file of the package.

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
from typing import Any

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
        run(command, [*FLAGS, *LEVELS[level], stamp, "-o", str(made), *files, "-lm"], folder)
        os.replace(made, destination / made.name)
    return destination / file_name(level)


def run(command: Sequence[str], arguments: Sequence[str], folder: Path) -> None:
    """Run the compiler in a folder.

    Raises:
        RuntimeError: if it cannot run or fails, with its first error message.
    """
    try:
        words = [*command, *arguments]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RuntimeError(f"the C compiler {shlex.join(command)} cannot run: {error}") from None
    if done.returncode != 0:
        said = [line for line in done.stderr.splitlines() if "error" in line] or [done.stderr.strip()[:200]]
        raise RuntimeError(f"the C compiler {shlex.join(command)} fails: {said[0].strip() or 'it says nothing'}")


def set_up(name: str, folder: Path, no_modules: Sequence[str] = ("setup.py",), **more: Any) -> None:
    """Call setuptools for a package with C files in one of its folders; the library knows nothing of Python.

    Args:
        name: of the package.
        folder: with the C files, beside the package's modules.
        no_modules: files beside the modules that no wheel holds.
        more: further commands of setuptools, by name.
    """
    from setuptools import Distribution, setup
    from setuptools.command.bdist_wheel import bdist_wheel
    from setuptools.command.build_py import build_py

    class BuildWithLibrary(build_py):
        """Also compiles the C files; beside them for an editable installation."""

        def run(self) -> None:
            super().run()
            build(folder, folder if self.editable_mode else Path(self.build_lib) / name / folder.name)

        def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
            modules = super().find_package_modules(package, package_dir)
            return [module for module in modules if Path(module[2]).name not in no_modules]

    class PlatformWheel(bdist_wheel):
        """A wheel of this platform for every Python."""

        def get_tag(self) -> tuple[str, str, str]:
            return "py3", "none", super().get_tag()[2]

    class WithLibrary(Distribution):
        """Not of Python files alone."""

        def has_ext_modules(self) -> bool:
            return True

    setup(
        cmdclass={"build_py": BuildWithLibrary, "bdist_wheel": PlatformWheel, **more},
        distclass=WithLibrary,
        setup_requires=[] if compiler() else ["ziglang>=0.13"],  # pip fetches it for the build
    )
