"""Binaries of an FMU: by the machine's own compiler, or by the wheel `ziglang`, which also compiles for others."""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from hystmpc.trials.errors import ExportError

_LONGEST_S = 600.0  # ziglang makes its C library first


@dataclass(frozen=True)
class Platform:
    """A machine for which a binary can be made.

    Attributes:
        system: as Python names it.
        tuple3: name in FMI 3.0; the key in `PLATFORMS` is that in FMI 2.0.
        target: of ziglang; an old C library, so that the binary runs on older systems too.
        ending: of a shared library.
    """

    system: str
    tuple3: str
    target: str
    ending: str

    def path(self, identifier: str, version: str) -> str:
        """Of its binary inside the FMU."""
        folder = self.tuple3 if version == "3.0" else _NAMES_2[self.tuple3]
        return f"binaries/{folder}/{identifier}.{self.ending}"


_NAMES_2 = MappingProxyType({"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"})
PLATFORMS: Mapping[str, Platform] = MappingProxyType(
    {
        "linux64": Platform("Linux", "x86_64-linux", "x86_64-linux-gnu.2.17", "so"),
        "win64": Platform("Windows", "x86_64-windows", "x86_64-windows-gnu", "dll"),
        "darwin64": Platform("Darwin", "x86_64-darwin", "x86_64-macos", "dylib"),
    }
)
"""Machines by the names that FMI 2.0 has for them."""


def host_platform() -> str | None:
    """The machine that this is; None where the standards have no common name for it."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    return next((name for name, known in PLATFORMS.items() if known.system == platform.system()), None)


def compiler_for(name: str) -> Sequence[str] | None:
    """Command of a C compiler for a platform: `CC`, `cc`, else ziglang; None where there is none."""
    if name == host_platform():
        own = shlex.split(os.environ.get("CC", "")) or [shutil.which("cc") or ""]
        if own[0]:
            return own
    if importlib.util.find_spec("ziglang") is None:
        return None
    return [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[name].target]


def compiled(name: str, sources: Mapping[str, str], main: str) -> bytes | None:
    """The shared library of C sources for a platform; None where there is no compiler.

    Args:
        main: the file that is compiled; the others are headers.

    Raises:
        ExportError: where the compiler fails; its first line says why.
    """
    command = compiler_for(name)
    if command is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        out = f"library.{PLATFORMS[name].ending}"
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared"]
        flags += [] if name == "win64" else ["-fPIC"]
        arguments = [*command, *flags, "-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-s", "-o", out, main, "-lm"]
        try:
            done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=_LONGEST_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"export-fmu: the compiler {command[0]} cannot run: {error}") from None
        if done.returncode:
            said = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[:200])
            raise ExportError(f"export-fmu: the compiler {shlex.join(command)} failed: {said}")
        return (Path(folder) / out).read_bytes()
