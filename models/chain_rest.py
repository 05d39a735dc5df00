"""Where a chain of operators rests: its exact state at any command and angle, without compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeVar, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Index, Vec

from .chain import Chain
from .kernels.program import dense

FLAT = 1e-3
"""A derivative of what the chain shows by the core's angle that is smaller leads nowhere."""

_ROUNDS, _CLOSE, _WITHIN = 8, 1e-9, 1e-6  # Newton steps; difference that is none; step back from an edge


class HeldCores(Protocol):
    """N rows held at their commands, see `nearest_shown`: what core and chain show, and the latter's derivative by the
    angle that the core was told (N,) each."""

    @property
    def core(self) -> Vec:
        """Angle that the core shows [deg]."""
        ...

    @property
    def signal(self) -> Vec:
        """Angle that the chain shows [deg]."""
        ...

    @property
    def moves(self) -> Vec:
        """Derivative of `signal` by the angle that the core was told."""
        ...

    def put(self, n: Index, other: Self) -> None:
        """Take rows n from another that has just these."""

    def rows(self, n: Index) -> Self:
        """A copy of some rows."""
        ...


Held = TypeVar("Held", bound=HeldCores)


def nearest_shown(angle: Vec, held_at: Callable[[Index, Vec], Held]) -> Held:
    """Rows whose chain shows angles (N,) [deg], or the nearest that it can.

    Newton's method on the angle that the core is told. Where that is beyond what the core can hold, the search goes on
    from the edge of what it can, a little within. Rows do not depend on others.

    Args:
        angle: seen (N,) [deg].
        held_at: rows of these numbers, whose cores are told these angles.
    """
    at, side, out = angle.copy(), np.zeros(angle.size), np.arange(angle.size)
    held = held_at(out, at)
    beyond = held.rows(out)  # where a row was first found to be beyond what the core can hold
    for _ in range(_ROUNDS):
        out = out[~(np.abs(angle - held.signal)[out] < _CLOSE)]
        edge = out[np.abs(held.moves[out]) < FLAT]
        if edge.size:
            new, past = edge[side[edge] == 0.0], side[edge]
            beyond.put(new, held.rows(new))
            side[edge] = np.sign(angle - held.signal)[edge]
            turned = edge[side[edge] != past]
            if turned.size:
                at[turned] = (held.core + side * _WITHIN)[turned]
                held.put(turned, held_at(turned, at[turned]))
            lost = edge[(side[edge] == past) | (np.abs(held.moves[edge]) < FLAT)]  # nothing within leads any further
            held.put(lost, beyond.rows(lost))
            out = np.setdiff1d(out, lost)
        if not out.size:
            break
        at[out] += (angle - held.signal)[out] / held.moves[out]
        held.put(out, held_at(out, at[out]))
    return held


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
    the one that was seen; where it cannot, at the nearest (`nearest_shown`). `StagedChain.settled` is the same rule
    with derivatives, which a fit needs; this one needs no compilation.

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
        held = nearest_shown(angle, lambda n, at: self._held(v[0, n], at))
        return np.ascontiguousarray(np.vstack([ahead, held.state]).T)

    def _held(self, v: Vec, a: Vec) -> _Held:
        state, core, signal, moves = _rows(self._behind, v, a)
        return _Held(state, core[0], signal[0], moves[0])


def _rows(function: Any, *inputs: Vec) -> list[Vec]:
    """Results (rows, N) of a function of numbers at N points."""
    if not inputs[0].size:
        return [np.empty((function.size1_out(k), 0)) for k in range(function.n_out())]
    return [np.array(values, dtype=np.float64) for values in function(*(ca.DM(each[None]) for each in inputs))]
