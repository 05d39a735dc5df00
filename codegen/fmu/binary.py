"""Binaries of an FMU: by the machine's own compiler, or by the wheel `ziglang`, which also compiles for others."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from ..compiler import compiler, shared_library, zig


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


def compiled(name: str, sources: Mapping[str, str], main: str) -> bytes | None:
    """The shared library of C sources for a platform; None where there is no compiler for it.

    Args:
        main: the file that is compiled; the others are headers.

    Raises:
        ExportError: where the compiler fails; its first error says why.
    """
    command = (compiler() if name == host_platform() else None) or zig("-target", PLATFORMS[name].target)
    flags = ["-O2", "-fvisibility=hidden", "-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-s"]
    flags += [] if name == "win64" else ["-fPIC"]
    return None if command is None else shared_library(command, flags, sources, main)
