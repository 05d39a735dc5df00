"""Operators one after another beside a device that is no chain: what acts on its command, or on its angle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.operators.operator import Operator
from hystmpc.trials.types import Vec

from .plant import clocks, settling_s, still


@final
class Line:
    """Operators with explicit state; none at all passes the signal on as it is.

    Args:
        operators: in the order in which the signal meets them.
        dt_s: sample time [s].
    """

    def __init__(self, operators: Sequence[Operator], dt_s: float) -> None:
        self._chain, self._dt = None, np.array([dt_s])
        if operators:
            self._chain = Chain(operators[0], after=tuple(operators[1:]))
            self._kernels = compile_step(self._chain.transition)

    @property
    def settling_s(self) -> float:
        """Time after which a held signal leaves it at rest [s]."""
        return 0.0 if self._chain is None else settling_s(self._chain)

    def at_rest(self, signal: float) -> Vec:
        """State (S,) after a signal that has been held for long."""
        if self._chain is None:
            return np.empty(0)
        return np.asarray(self._chain.rest(signal, signal, self._chain.values), dtype=np.float64).ravel()

    def run(self, state: Vec, signal: Vec) -> tuple[Vec, Vec]:
        """What becomes of a signal (T,), and the state after it."""
        return (signal, state) if self._chain is None else self._run(self._chain.values, state, signal)

    def settle(self, state: Vec, signal: Vec) -> tuple[Vec, Vec]:
        """As `run`, with everything that follows a clock standing still and its clock at zero afterwards."""
        if self._chain is None:
            return signal, state
        shown, after = self._run(still(self._chain), state, signal)
        return shown, np.where(clocks(self._chain), 0.0, after)

    def _run(self, values: Vec, state: Vec, signal: Vec) -> tuple[Vec, Vec]:
        kernels = self._kernels
        after, shown = state.reshape(1, -1).copy(), np.empty((1, signal.size))
        row = np.ascontiguousarray(signal, dtype=np.float64)[None]
        kernels.simulate(after, row, values, self._dt, kernels.step_constants, shown)
        return shown[0], after[0]
