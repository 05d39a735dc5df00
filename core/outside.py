"""Functions written in Python that the engine calls: what they raise becomes an answer, and is kept for the caller."""

from __future__ import annotations

import ctypes
import math
from collections import deque
from collections.abc import Callable
from threading import local
from typing import final

import numpy as np
from numpy.typing import NDArray

_MOST = 8  # faults that are kept


@final
class _Faults(local):
    """What functions of a thread have raised, the newest last."""

    def __init__(self) -> None:
        self.raised: deque[BaseException] = deque(maxlen=_MOST)


_faults = _Faults()


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


def numbers_at(address: int | None, *shape: int) -> NDArray[np.float64]:
    """Return the engine's numbers at an address as an array on its memory; an empty one where there are none."""
    if not address or min(shape) <= 0:
        return np.empty(0)
    memory = (ctypes.c_double * math.prod(shape)).from_address(address)
    return np.ndarray(shape, dtype=np.float64, buffer=memoryview(memory))


def keep_fault(error: BaseException) -> None:
    """Keep a fault of this thread."""
    _faults.raised.append(error)


def raised_last() -> BaseException | None:
    """Fetch what a function of this thread has raised last, for a caller that raises it again; None if nothing."""
    return _faults.raised.pop() if _faults.raised else None


def forget_faults() -> None:
    """Forget what functions of this thread have raised so far."""
    _faults.raised.clear()


def faults() -> list[str]:
    """Fetch what functions of this thread have raised, in their order, each in one line.

    Raises:
        BaseException: what is no `Exception`, such as the interruption by a user.
    """
    raised = list(_faults.raised)
    _faults.raised.clear()
    for error in raised:
        if not isinstance(error, Exception):
            raise error
    return [f"{type(error).__name__}: {' '.join(str(error).split())}"[:200] for error in raised]
