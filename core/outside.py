"""Functions written in Python that the engine calls: what they raise becomes an answer, and is kept for the caller."""

from __future__ import annotations

from collections.abc import Callable
from threading import local
from typing import final

import numpy as np

_local = local()


@final
class Guarded:
    """A function as the engine calls it: 0, or 1 where it has raised.

    Args:
        function: whose answer is written into memory.
    """

    def __init__(self, function: Callable[..., None]) -> None:
        self.function = function

    def __call__(self, *arguments: float) -> int:
        try:
            with np.errstate(all="ignore"):
                self.function(*arguments)
        except BaseException as error:  # noqa: BLE001 - a model may raise anything, and no exception passes C
            keep_fault(error)
            return 1
        return 0


def guarded(function: Callable[..., None]) -> Callable[..., int]:
    """Return the function as the engine calls it: 0, or 1 where it has raised."""
    return Guarded(function)


def keep_fault(error: BaseException) -> None:
    """Keep a fault of this thread: the first one for `last_fault`, the last one for `raised_last`."""
    _local.last = error
    if getattr(_local, "first", None) is None:
        _local.first = error


def raised_last() -> BaseException | None:
    """Fetch what a function of this thread has raised last, for a caller that raises it again; None if nothing."""
    error, _local.last = getattr(_local, "last", None), None
    if error is getattr(_local, "first", None):
        _local.first = None
    return error


def last_fault() -> str:
    """Fetch in one line what functions of this thread have raised first since the last call; empty if nothing.

    Raises:
        BaseException: what is no `Exception`, such as the interruption by a user.
    """
    error, _local.first, _local.last = getattr(_local, "first", None), None, None
    if error is None or isinstance(error, Exception):
        return "" if error is None else f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]
    raise error
