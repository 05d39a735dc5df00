"""What takes seconds to make and many tests look at: made once, by whichever worker asks first."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from filelock import FileLock

T = TypeVar("T")
PLACES: list[Path] = []
"""The folder that all workers of this run see; empty where there is one process, which keeps its own."""


def shared(name: str, make: Callable[[], T]) -> T:
    """What `make` returns; another worker that asks by the same name gets a copy, after waiting for the first one.

    Raises:
        ImportError: without cloudpickle, which comes with the extra `tune`.
    """
    if not PLACES:
        return make()
    cloudpickle = import_module("cloudpickle")  # graphs are made by functions within functions
    file = PLACES[0] / f"{hashlib.sha256(name.encode()).hexdigest()}.pickle"
    with FileLock(f"{file}.lock"):
        if not file.exists():
            part = file.with_suffix(".part")
            part.write_bytes(cloudpickle.dumps(make()))
            part.replace(file)
        return cloudpickle.loads(file.read_bytes())  # type: ignore[no-any-return]
