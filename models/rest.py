"""The state at rest of any model, from the command that is held and the angle that is seen; of a chain it is exact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar, final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Index, Vec

from .contract.metadata import InitialRule, ModelMetadata, Start

if TYPE_CHECKING:
    from .chain import Chain

_Part = Callable[[Vec, Vec], Vec]  # commands and angles (N,) -> states (N, S)


@final
class RestRule:
    """States of a device that has been held at a command and shows an angle, before the warm-up.

    Of a chain of operators it is exact (`ChainRest`). Operators of a connection rest where they are held, and the model
    behind them starts by its file's rule, as any other model does.

    Args:
        facts: of the model.
        start: which rule of the file.
        chain: the operators, where the model is a chain; those that the facts name where left out.
    """

    def __init__(self, facts: ModelMetadata, start: Start, chain: Chain | None = None) -> None:
        self._facts, self._rule, self._chain = facts, facts.rule(start), chain

    @property
    def hold_samples(self) -> int:
        """Samples for which the command is held from these states on, until the model rests."""
        chain = self._whole
        return self._facts.warmup_samples if chain is None else chain.rest_samples

    def states(self, commands: Vec, angles: Vec) -> Vec:
        """States (N, S) at commands (N,) [command unit] that show angles (N,) [deg]."""
        return np.hstack([part(commands, angles) for part in self._parts])

    @cached_property
    def _whole(self) -> Chain | None:
        """The chain of which the whole model consists; None where it does not, or its operators are not known here."""
        if self._chain is not None or self._facts.chain is None:
            return self._chain
        from .chain import chain_from

        try:
            chain = chain_from(self._facts.chain, "chain")
        except ModelError:  # an effect of somebody else's, whose code is not installed here
            return None
        return chain if chain.state_size == self._facts.state_size else None

    @cached_property
    def _parts(self) -> list[_Part]:

        dt_s = self._facts.dt_s
        if self._whole is not None:
            return [ChainRest(self._whole, dt_s).states]
        parts, cut, shows = list[_Part](), 0, True
        for connection in self._facts.connections:
            from .chain import chain_from

            chain = chain_from(connection.chain, "connections")
            in_series, cut = connection.way == "series", cut + chain.state_size
            parts.append(_drive(ChainRest(chain, dt_s)) if in_series else ChainRest(chain, dt_s).states)
            shows = shows and in_series
        return [*parts, _by_rule(self._rule.behind(cut), shows)]


def _drive(rest: ChainRest) -> _Part:
    """States of operators in series, whose output is the held command."""
    return lambda commands, angles: rest.states(commands, commands)


def _by_rule(rule: InitialRule, shows: bool) -> _Part:
    """States by the rule of a file, at angle zero where operators in parallel show the angle."""

    def states(commands: Vec, angles: Vec) -> Vec:
        seen = angles if shows else np.zeros_like(angles)
        state = rule.state(seen[:, None], commands[:, None])
        return np.array(np.broadcast_to(state, (commands.size, len(rule.offset))))

    return states


FLAT = 1e-3
"""A derivative of what the chain shows by the core's angle that is smaller leads nowhere."""

_ROUNDS, _CLOSE, _WITHIN = 8, 1e-9, 1e-6  # Newton steps; difference that is none; step back from an edge


class HeldCores(Protocol):
    """N rows held at their commands, see `nearest_shown`: what core and chain show, and the latter's derivative by the
    angle given to the core (N,) each."""

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
        """Derivative of `signal` by the angle given to the core."""
        ...

    def put(self, n: Index, other: Self) -> None:
        """Take rows n from another that has just these."""

    def rows(self, n: Index) -> Self:
        """A copy of some rows."""
        ...


Held = TypeVar("Held", bound=HeldCores)


def nearest_shown(angle: Vec, held_at: Callable[[Index, Vec], Held]) -> Held:
    """Rows whose chain shows angles (N,) [deg], or the nearest that it can.

    Newton's method on the angle given to the core. Where that is beyond what the core can hold, the search goes on
    from the edge of what it can, a little within. Rows do not depend on others.

    Args:
        angle: seen (N,) [deg].
        held_at: rows of these numbers, whose cores are given these angles.
    """
    at, side, out = angle.copy(), np.zeros(angle.size), np.arange(angle.size)
    held = held_at(out, at)
    beyond = held.rows(out)  # where a row was first beyond what the core can hold
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
        moves: derivative of `signal` by the angle given to the core (N,).
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
        import casadi as ca  # a model without operators does without it

        from .kernels.program import dense

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
    import casadi as ca

    if not inputs[0].size:
        return [np.empty((function.size1_out(k), 0)) for k in range(function.n_out())]
    return [np.array(result, dtype=np.float64) for result in function(*(ca.DM(each[None]) for each in inputs))]
