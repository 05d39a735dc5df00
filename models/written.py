"""Predictors and inverses written in Python as the engine calls them: `hystmpc_outside` of core/predictor.h."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from typing import Any, final

import numpy as np

from hystmpc.core.structs import Struct
from hystmpc.trials.types import Vec

_LONGEST = 200  # characters of a fault


@final
class Written:
    """Methods of a predictor or of an inverse as functions on memory: 0, or 1 where the method has raised.

    Args:
        owner: of the methods, a `Predictor` or an `Inverse`.
        size: entries of a predictor's state.

    Attributes:
        error: raised last, until `taken_error` has fetched it.
    """

    def __init__(self, owner: Any, size: int = 0) -> None:
        self._owner, self._size = owner, size
        self.error: BaseException | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Written, (self._owner, self._size)

    def advance(self, x: int, u: float, theta: int) -> int:
        """One sample later, see `hystmpc_outside`."""

        def answer() -> None:
            state = _numbers(x, self._size)
            angle, following = self._owner.advance(state.copy(), u)
            after = _shaped(following, state.shape)
            _numbers(theta, 1)[:] = float(angle)
            state[:] = after

        return self._answered(answer)

    def run(self, x: int, rows: int, samples: int, plans: int, angles: int) -> int:
        """Angles of plans, see `hystmpc_outside`."""

        def answer() -> None:
            given = _numbers(plans, rows, samples).copy()
            _numbers(angles, rows, samples)[:] = _shaped(
                self._owner.rollout(_numbers(x, self._size).copy(), given), given.shape
            )

        return self._answered(answer)

    def linearise(self, x: int, samples: int, plan: int, angles: int, jacobian: int) -> int:
        """Angles and slopes along a plan, see `hystmpc_outside`."""

        def answer() -> None:
            given = _numbers(plan, samples).copy()
            along, slopes = self._owner.linearise(_numbers(x, self._size).copy(), given)
            _numbers(angles, samples)[:] = _shaped(along, (samples,))
            _numbers(jacobian, samples, samples)[:] = _shaped(slopes, (samples, samples))

        return self._answered(answer)

    def command(self, x: int, states: int, theta: float, u_last: float, u: int) -> int:
        """Command for an angle, see `hystmpc_outside`."""

        def answer() -> None:
            _numbers(u, 1)[:] = float(self._owner.command(_numbers(x, states).copy(), theta, u_last))

        return self._answered(answer)

    def _answered(self, answer: Callable[[], None]) -> int:
        try:
            with np.errstate(all="ignore"):  # a number that is not finite is an answer
                answer()
        except BaseException as error:  # noqa: BLE001 - through C no exception passes; `taken_error` hands it on
            self.error = error
            return 1
        return 0


def _numbers(address: int, *shape: int) -> Vec:
    """The numbers at an address."""
    memory = (ctypes.c_double * math.prod(shape)).from_address(address)
    return np.ndarray(shape, dtype=np.float64, buffer=memory)


def _shaped(values: Any, shape: tuple[int, ...]) -> Vec:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"model: got shape {array.shape}, expected {shape}")
    return array


def written_in(part: Any) -> Iterator[Written]:
    """What is written in Python in a struct and in all that it points to."""
    if not isinstance(part, Struct):
        return
    for value in part.fields.values():
        owner = getattr(value, "__self__", None)
        if isinstance(owner, Written):
            yield owner
        yield from written_in(value)


def taken_error(part: Struct) -> BaseException | None:
    """Fetch what a function in Python under this struct has raised last; None where none has."""
    found = None
    for one in written_in(part):
        found, one.error = one.error or found, None
    return found


def fault_of(part: Struct) -> str:
    """Fetch the same as one line; empty where nothing has been raised."""
    error = taken_error(part)
    return "" if error is None else f"{type(error).__name__}: {' '.join(str(error).split())}"[:_LONGEST]
