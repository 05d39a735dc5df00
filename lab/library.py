"""The laboratory's functions in C, of the files in `c/`: compiled, checked and bound as the engine's are."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from hystmpc.core.library import compiled

FOLDER = Path(__file__).resolve().parent / "c"
"""Place of the C files and of their libraries."""


@cache
def laboratory() -> Any:
    """Functions of the laboratory by their names without `hystmpc_`; errors as those of `core.library.engine`."""
    return compiled(FOLDER)
