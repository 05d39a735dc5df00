"""State at rest of any model, from the constant command and the measured angle; exact for a chain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

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
        self._start: Start = start

    @property
    def hold_samples(self) -> int:
        """Number of samples for which the command is held from these states on, until the model rests."""
        chain = self.chain
        return self._facts.warmup_samples if chain is None else chain.rest_samples

    def at_inputs(self, values: Mapping[str, float]) -> RestRule:
        """Rule at other values of the measured inputs than their references."""
        if not values or self.chain is None:
            return self
        return RestRule(self._facts, self._start, self.chain.at_inputs(values))

    def states(self, commands: Vec, angles: Vec) -> Vec:
        """States (N, S) at commands (N,) [command unit] with output angles (N,) [deg]."""
        return np.hstack([part(commands, angles) for part in self._parts])

    @cached_property
    def part(self) -> Struct:
        """The rule as the engine reads it, `hystmpc_rest_rule` of core/at_rest.h."""
        chain, held, kinds = self.chain, self.hold_samples, constants()
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
    def chain(self) -> Chain | None:
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
        if self.chain is not None:
            return [ChainRest(self.chain, dt_s).states]
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


@final
class ChainRest:
    """States of a chain after a constant command at an output angle.

    Every operator rests at the output of the one before it, and the core at the angle for which the whole chain has the
    measured angle or the nearest possible one. `StagedChain.settled` adds derivatives.

    Args:
        chain: its delays with a store for the sample time.
    """

    def __init__(self, chain: Chain, dt_s: float) -> None:
        from .stages import prepared  # CasADi is not loaded for models without operators

        self._run, self._core, self._values = prepared(chain.operators, dt_s), len(chain.before), chain.values

    def states(self, command: Vec, angle: Vec) -> Vec:
        """States (N, S) at commands (N,) with output angles (N,) [deg], or the nearest possible ones."""
        u, y = (np.ascontiguousarray(rest, dtype=np.float64) for rest in (command, angle))
        still = np.empty((self._values.size, 0))
        return np.ascontiguousarray(self._run.code.settle(self._run.kept, self._core, u, y, self._values, still)[0].T)
