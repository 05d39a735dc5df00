"""Predictors and inverses written in Python as the engine calls them: `hystmpc_outside` of core/predictor.h."""

from __future__ import annotations

import ctypes
from typing import Any, final

import numpy as np

from hystmpc.core.outside import guarded, numbers_at
from hystmpc.core.structs import Struct, struct
from hystmpc.trials.types import Vec


@final
class PythonMethods:
    """Methods of a predictor or of an inverse as functions on memory, which is copied for them.

    Args:
        owner: of the methods, a `Predictor` or an `Inverse`.
        size: entries of a predictor's state.
    """

    def __init__(self, owner: Any, size: int = 0) -> None:
        self._owner, self._size = owner, size

    def predictor(self) -> Struct:
        """`hystmpc_outside` of a predictor."""
        return struct(
            "hystmpc_outside",
            advance=guarded(self._advance),
            run=guarded(self._run),
            linearise=guarded(self._linearise),
        )

    def inverse(self) -> Struct:
        """`hystmpc_outside` of an inverse."""
        return struct("hystmpc_outside", command=guarded(self._command))

    def _advance(self, x: int, u: float, theta: int) -> None:
        state = numbers_at(x, self._size)
        angle, following = self._owner.advance(state.copy(), u)
        after = _shaped(following, state.shape)
        ctypes.c_double.from_address(theta).value = float(angle)
        state[:] = after

    def _run(self, x: int, rows: int, samples: int, plans: int, angles: int) -> None:
        answered = self._owner.rollout(numbers_at(x, self._size).copy(), numbers_at(plans, rows, samples).copy())
        numbers_at(angles, rows, samples)[:] = _shaped(answered, (rows, samples))

    def _linearise(self, x: int, samples: int, plan: int, angles: int, jacobian: int) -> None:
        along, slopes = self._owner.linearise(numbers_at(x, self._size).copy(), numbers_at(plan, samples).copy())
        numbers_at(angles, samples)[:] = _shaped(along, (samples,))
        numbers_at(jacobian, samples, samples)[:] = _shaped(slopes, (samples, samples))

    def _command(self, x: int, states: int, theta: float, u_last: float, u: int) -> None:
        command = self._owner.command(numbers_at(x, states).copy(), theta, u_last)
        ctypes.c_double.from_address(u).value = float(command)


def _shaped(values: Any, shape: tuple[int, ...]) -> Vec:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"model: got shape {array.shape}, expected {shape}")
    return array
