"""Operators in series, with explicit state: on a plant's command, on its angle, in its sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.kernels.chain_kernels import ChainKernels, compile_step
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.trials.types import Vec

_SETTLED = 20.0  # time constants after which nothing is left of a step: e^-20 of 100 deg is 2e-7 deg
_LONGEST_REST_S = 600.0  # slower creep has not settled when an experiment begins


def settling_s(chain: Chain) -> float:
    """Time after which a held command leaves the chain at rest [s]."""
    return sum(_settling_of(operator) for operator in chain.operators)


def _settling_of(operator: Operator) -> float:
    if isinstance(operator, Lag):
        return _SETTLED * max(operator.tau_s, *operator.tau_down_s, 0.0)
    if isinstance(operator, Creep):
        return min(_SETTLED * max(operator.taus_s), _LONGEST_REST_S)
    return operator.delay_s if isinstance(operator, Delay) else 0.0


def still(chain: Chain) -> Vec:
    """Parameter values of the chain with everything that follows a clock at its neutral values."""
    values: list[float] = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        values += effect.neutral_values(operator) if effect is not None and effect.clocks else operator.values
    return np.array(values)


def clocks(chain: Chain) -> NDArray[np.bool_]:
    """Mask of the state's entries that are clocks."""
    found = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        found += [effect is not None and name in effect.clocks for name in operator.states]
    return np.array(found, dtype=bool)


@final
class OperatorCascade:
    """Operators in series with explicit state; none at all passes the signal on as it is.

    Args:
        operators: in the order in which the signal meets them.
        dt_s: sample time [s].
    """

    def __init__(self, operators: Sequence[Operator], dt_s: float) -> None:
        self._chain = Chain(operators[0], after=tuple(operators[1:])) if operators else None
        self._kernels = compile_step(self._chain.transition) if self._chain else None
        self._dt_s = dt_s

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
        """Output for a signal (T,), and the state after it."""
        return (
            (signal, state) if self._chain is None else run_chain(self._chain, self._dt_s, state, signal, self._kernels)
        )

    def settle(self, state: Vec, signal: Vec) -> tuple[Vec, Vec]:
        """As `run`, with everything that follows a clock standing still and its clock at zero afterwards."""
        if self._chain is None:
            return signal, state
        return run_chain(self._chain, self._dt_s, state, signal, self._kernels, settle=True)


def run_chain(
    chain: Chain, dt_s: float, state: Vec, signal: Vec, kernels: ChainKernels | None = None, settle: bool = False
) -> tuple[Vec, Vec]:
    """Output of a chain (T,) for a signal (T,), and its state afterwards.

    Args:
        dt_s: sample time [s].
        state: before the first sample (S,); left as it is.
        kernels: of the chain, looked up where left out, which takes longer than a sample.
        settle: let everything that follows a clock stand still, and set its clock to zero afterwards.
    """
    kernels = kernels or compile_step(chain.transition)
    after, shown = state.reshape(1, -1).copy(), np.empty((1, signal.size))
    row, values = np.ascontiguousarray(signal, dtype=np.float64)[None], still(chain) if settle else chain.values
    kernels.simulate(after, row, values, np.array([dt_s]), kernels.step_constants, shown)
    return shown[0], np.where(clocks(chain), 0.0, after[0]) if settle else after[0]
