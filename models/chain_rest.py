"""Where a chain of operators rests: its exact state at any command and angle, without compiled kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Index, Vec

from .chain import Chain
from .kernels.program import dense

ROUNDS, CLOSE, FLAT, WITHIN = 8, 1e-9, 1e-3, 1e-6
"""Newton steps; difference that is none; derivative that leads nowhere; step back from an edge of what a core holds."""


@dataclass(frozen=True, eq=False)
class _Held:
    """N rows held at their commands.

    Attributes:
        state: from the core on (S, N).
        core: angle that the core shows (N,) [deg].
        signal: angle that the chain shows (N,) [deg].
        moves: derivative of `signal` by the angle that the core was told (N,).
    """

    state: Vec
    core: Vec
    signal: Vec
    moves: Vec

    def put(self, n: Index, other: _Held) -> None:
        """Take rows n from another that has just these."""
        self.state[:, n], self.core[n], self.signal[n], self.moves[n] = (
            other.state, other.core, other.signal, other.moves,
        )  # fmt: skip

    def rows(self, n: Index) -> _Held:
        """A copy of some rows."""
        return _Held(self.state[:, n], self.core[n], self.signal[n], self.moves[n])


@final
class ChainRest:
    """States of a chain that has been held at a command and shows an angle.

    Every operator rests at what the one before it hands on, and the core at the angle for which the whole chain shows
    the one that was seen; where it cannot, at the nearest. The same rule by the same steps as `StagedChain.settled`,
    which a fit uses for its derivatives; this one needs no compilation.

    Args:
        chain: its delays with a store for the sample time.
        dt_s: sample time [s].
    """

    def __init__(self, chain: Chain, dt_s: float) -> None:
        u, v, a = ca.SX.sym("u"), ca.SX.sym("v"), ca.SX.sym("a")
        operators = [(operator, ca.DM(operator.values)) for operator in chain.operators]
        cut, signal, states = len(chain.before), u, [ca.SX(0, 1)]
        for operator, p in operators[:cut]:
            states.append(operator.at_rest(signal, signal, p))
            _, signal = operator.equation(states[-1], signal, p, dt_s)
        self._before = dense("before", [u], [ca.vertcat(*states), signal])
        core, p = operators[cut]
        states = [core.at_rest(v, a, p)]
        _, shown = core.equation(states[0], v, p, dt_s)
        signal = shown
        for operator, p in operators[cut + 1 :]:
            states.append(operator.at_rest(signal, signal, p))
            _, signal = operator.equation(states[-1], signal, p, dt_s)
        self._behind = dense("behind", [v, a], [ca.vertcat(*states), shown, signal, ca.jacobian(signal, a)])

    def states(self, command: Vec, angle: Vec) -> Vec:
        """States (N, S) at commands (N,) that show angles (N,) [deg], or the nearest that they can."""
        angle = np.asarray(angle, dtype=np.float64)
        ahead, v = _rows(self._before, np.asarray(command, dtype=np.float64))
        return np.ascontiguousarray(np.vstack([ahead, self._shown(v[0], angle).state]).T)

    def _shown(self, v: Vec, angle: Vec) -> _Held:
        """Newton's method on the core's angle; from an edge of what the core can hold on, a little within."""
        at, side, out = angle.copy(), np.zeros(angle.size), np.arange(angle.size)
        held = self._held(v, at)
        beyond = held.rows(out)
        for _ in range(ROUNDS):
            out = out[~(np.abs(angle - held.signal)[out] < CLOSE)]
            edge = out[np.abs(held.moves[out]) < FLAT]
            if edge.size:
                new, past = edge[side[edge] == 0.0], side[edge]
                beyond.put(new, held.rows(new))
                side[edge] = np.sign(angle - held.signal)[edge]
                turned = edge[side[edge] != past]
                at[turned] = (held.core + side * WITHIN)[turned]
                held.put(turned, self._held(v[turned], at[turned]))
                lost = edge[(side[edge] == past) | (np.abs(held.moves[edge]) < FLAT)]
                held.put(lost, beyond.rows(lost))
                out = np.setdiff1d(out, lost)
            if not out.size:
                break
            at[out] += (angle - held.signal)[out] / held.moves[out]
            held.put(out, self._held(v[out], at[out]))
        return held

    def _held(self, v: Vec, a: Vec) -> _Held:
        state, core, signal, moves = _rows(self._behind, v, a)
        return _Held(state, core[0], signal[0], moves[0])


def _rows(function: Any, *inputs: Vec) -> list[Vec]:
    """Results (rows, N) of a function of numbers at N points."""
    if not inputs[0].size:
        return [np.empty((function.size1_out(k), 0)) for k in range(function.n_out())]
    return [np.array(found, dtype=np.float64) for found in function(*(ca.DM(each[None]) for each in inputs))]
