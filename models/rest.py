"""State at rest of any model, from the constant command and the measured angle; exact for a chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeVar, final

import numpy as np

from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Index, Vec

from .contract.metadata import InitialRule, ModelMetadata, Start

if TYPE_CHECKING:
    from .chain import Chain

_Part = Callable[[Vec, Vec], Vec]  # commands and angles (N,) -> states (N, S)


@final
class RestRule:
    """States of a device after a constant command at an output angle, before the warm-up.

    The states are exact for a chain of operators (`ChainRest`); other models start by their file's rule.

    Args:
        chain: the operators, where the model is a chain; those in the facts where left out.
    """

    def __init__(self, facts: ModelMetadata, start: Start, chain: Chain | None = None) -> None:
        self._facts, self._rule, self._chain = facts, facts.rule(start), chain

    @property
    def hold_samples(self) -> int:
        """Number of samples for which the command is held from these states on, until the model rests."""
        chain = self._whole
        return self._facts.warmup_samples if chain is None else chain.rest_samples

    def states(self, commands: Vec, angles: Vec) -> Vec:
        """States (N, S) at commands (N,) [command unit] with output angles (N,) [deg]."""
        return np.hstack([part(commands, angles) for part in self._parts])

    @cached_property
    def part(self) -> Struct:
        """The rule as the engine reads it, `hystmpc_rest_rule` of core/at_rest.h."""
        chain, held, kinds = self._whole, self.hold_samples, constants()
        if chain is not None:
            from .stages import prepared

            run = prepared(chain.operators, self._facts.dt_s)
            code, core = run.code, len(chain.before)
            tables = {"chain": code.code, "constants": code.constants, "parameters": chain.values, "kept": run.kept}
            return struct("hystmpc_rest_rule", kind=kinds["HYSTMPC_SETTLED"], held=held, core=core, **tables)
        rule = self._rule
        by_command = np.array(rule.by_command or (0.0,) * len(rule.offset))
        offset = np.array(rule.offset) - rule.at_command * by_command
        rows = {"offset": offset, "by_angle": rule.slope, "by_command": by_command}
        return struct("hystmpc_rest_rule", kind=kinds["HYSTMPC_RULED"], held=held, **rows)

    @cached_property
    def _whole(self) -> Chain | None:
        """Chain of the whole model; None where it is no chain, or its operators are unknown here."""
        if self._chain is not None or self._facts.chain is None:
            return self._chain
        from .chain import chain_from

        try:
            chain = chain_from(self._facts.chain, "chain")
        except ModelError:  # effect of a package that is not installed
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
    """States of operators in series, whose output is the constant command."""
    return lambda commands, angles: rest.states(commands, commands)


def _by_rule(rule: InitialRule, shows: bool) -> _Part:
    """States by the rule of a file, at angle zero where operators in parallel have the angle."""

    def states(commands: Vec, angles: Vec) -> Vec:
        seen = angles if shows else np.zeros_like(angles)
        state = rule.state(seen[:, None], commands[:, None])
        return np.array(np.broadcast_to(state, (commands.size, len(rule.offset))))

    return states


FLAT = 1e-3
"""A derivative of what the chain shows by the core's angle that is smaller leads nowhere."""

_ROUNDS, _CLOSE, _WITHIN = 8, 1e-9, 1e-6  # Newton steps; tolerance; step back from an edge


class HeldCores(Protocol):
    """Interface of N rows at constant commands, see `nearest_shown`: angles of core and chain, and their derivative."""

    @property
    def core(self) -> Vec:
        """Angle of the core [deg]."""
        ...

    @property
    def signal(self) -> Vec:
        """Output angle of the chain [deg]."""
        ...

    @property
    def moves(self) -> Vec:
        """Derivative of `signal` by the angle given to the core."""
        ...

    def put(self, n: Index, other: Self) -> None:
        """Replace rows n by those of another."""

    def rows(self, n: Index) -> Self:
        """Copy of some rows."""
        ...


Held = TypeVar("Held", bound=HeldCores)


def nearest_shown(angle: Vec, held_at: Callable[[Index, Vec], Held]) -> Held:
    """Rows whose chain has output angles (N,) [deg], or the nearest possible ones.

    Newton's method on the angle given to the core. Where that is beyond the core's range, the search continues a little
    within the edge of the range. Rows are independent.

    Args:
        angle: measured (N,) [deg].
        held_at: function from row numbers and core angles to the rows.
    """
    at, side, out = angle.copy(), np.zeros(angle.size), np.arange(angle.size)
    held = held_at(out, at)
    beyond = held.rows(out)  # rows at their first point outside the core's range
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
            lost = edge[(side[edge] == past) | (np.abs(held.moves[edge]) < FLAT)]  # no angle within the range is nearer
            held.put(lost, beyond.rows(lost))
            out = np.setdiff1d(out, lost)
        if not out.size:
            break
        at[out] += (angle - held.signal)[out] / held.moves[out]
        held.put(out, held_at(out, at[out]))
    return held


@dataclass(frozen=True, eq=False)
class _Held:
    """Rows at constant commands: state from the core on (S, N), and the quantities of `HeldCores` (N,)."""

    state: Vec
    core: Vec
    signal: Vec
    moves: Vec

    def put(self, n: Index, other: _Held) -> None:
        self.state[:, n], self.core[n], self.signal[n], self.moves[n] = (
            other.state, other.core, other.signal, other.moves,
        )  # fmt: skip

    def rows(self, n: Index) -> _Held:
        return _Held(self.state[:, n], self.core[n], self.signal[n], self.moves[n])


@final
class ChainRest:
    """States of a chain after a constant command at an output angle.

    Every operator rests at the output of the one before it, and the core at the angle for which the whole chain has the
    measured angle or the nearest possible one (`nearest_shown`). `StagedChain.settled` adds derivatives.

    Args:
        chain: its delays with a store for the sample time.
    """

    def __init__(self, chain: Chain, dt_s: float) -> None:
        import casadi as ca  # not loaded for models without operators

        from .program import dense

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
        """States (N, S) at commands (N,) with output angles (N,) [deg], or the nearest possible ones."""
        angle = np.asarray(angle, dtype=np.float64)
        ahead, v = _rows(self._before, np.asarray(command, dtype=np.float64))
        held = nearest_shown(angle, lambda n, at: self._held(v[0, n], at))
        return np.ascontiguousarray(np.vstack([ahead, held.state]).T)

    def _held(self, v: Vec, a: Vec) -> _Held:
        state, core, signal, moves = _rows(self._behind, v, a)
        return _Held(state, core[0], signal[0], moves[0])


def _rows(function: Any, *inputs: Vec) -> list[Vec]:
    import casadi as ca

    if not inputs[0].size:
        return [np.empty((function.size1_out(k), 0)) for k in range(function.n_out())]
    return [np.array(result, dtype=np.float64) for result in function(*(ca.DM(each[None]) for each in inputs))]
