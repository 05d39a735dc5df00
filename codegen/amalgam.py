"""The engine's C files as one text, which needs no other file: for an exported controller, and for an FMU."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import resources

ONE_FILE = """#define HYSTMPC_API static
#define HYSTMPC_LOCAL static
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-function" /* a device does not need all of the engine */
#endif
"""
"""Makes every function of the engine a part of the one file alone."""

_SYSTEM = re.compile(r"^#include (<(?:float|math|stddef|stdint|string)\.h>)\n", re.MULTILINE)
_ENGINE = re.compile(r'^#include "(.+)"\n', re.MULTILINE)


def amalgam(names: Iterable[str]) -> str:
    """Text of the engine's C files in this order, each header once, in front of the first file that includes it.

    The text may be compiled as it is, and then offers the functions of the library; behind `ONE_FILE` it has none.
    Macros of an export come before it: `HYSTMPC_SINGLE`, `HYSTMPC_BLOCK`, `HYSTMPC_LANES`.

    Args:
        names: of C files in `core/`, such as `chain.c`.

    Raises:
        FileNotFoundError: if the engine has no such file, or a file includes a header that it does not have.
    """
    seen: set[str] = set()
    text = "\n".join(_inlined(name, seen) for name in names)
    headers = sorted(set(_SYSTEM.findall(text)))
    return "".join(f"#include {header}\n" for header in headers) + "\n" + _SYSTEM.sub("", text)


def _inlined(name: str, seen: set[str]) -> str:
    if name in seen:
        return ""
    seen.add(name)
    text = resources.files("hystmpc.core").joinpath(name).read_text(encoding="utf-8")
    return _ENGINE.sub(lambda match: _inlined(match[1], seen), text)
