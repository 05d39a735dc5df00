"""Functions written in Python that the engine calls: what they raise becomes an answer, and is kept in words."""

from __future__ import annotations

from collections.abc import Callable
from threading import local

import numpy as np

_local = local()


def guarded(function: Callable[..., None]) -> Callable[..., int]:
    """Return the function as the engine calls it: 0, or 1 where it has raised."""

    def answered(*arguments: float) -> int:
        try:
            with np.errstate(all="ignore"):
                function(*arguments)
        except Exception as error:  # noqa: BLE001 - a model may raise anything, the loop must go on
            keep_fault(error)
            return 1
        return 0

    return answered


def keep_fault(error: Exception) -> None:
    """Keep the first fault of this thread in one line."""
    if not getattr(_local, "fault", ""):
        _local.fault = f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


def last_fault() -> str:
    """Return what a function of this thread has raised since the last call; empty if nothing."""
    fault, _local.fault = getattr(_local, "fault", ""), ""
    return str(fault)
