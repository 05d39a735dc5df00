"""The state at rest of any model: one rule from the command that is held and the angle that is seen."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from .contract.metadata import InitialRule, ModelMetadata, Start

if TYPE_CHECKING:
    from .chain import Chain
    from .chain_rest import ChainRest

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
        from .chain_spec import chain_from

        try:
            chain = chain_from(self._facts.chain, "chain")
        except ModelError:  # an effect of somebody else's, whose code is not installed here
            return None
        return chain if chain.state_size == self._facts.state_size else None

    @cached_property
    def _parts(self) -> list[_Part]:
        from .chain_rest import ChainRest  # loads CasADi

        dt_s = self._facts.dt_s
        if self._whole is not None:
            return [ChainRest(self._whole, dt_s).states]
        parts, cut, shows = list[_Part](), 0, True
        for connection in self._facts.connections:
            from .chain_spec import chain_from

            chain = chain_from(connection.chain, "connections")
            in_series, cut = connection.way == "series", cut + chain.state_size
            parts.append(_drive(ChainRest(chain, dt_s)) if in_series else ChainRest(chain, dt_s).states)
            shows = shows and in_series
        return [*parts, _by_rule(self._rule.behind(cut), shows)]


def _drive(rest: ChainRest) -> _Part:
    """What is in series shows the command that is held."""
    return lambda commands, angles: rest.states(commands, commands)


def _by_rule(rule: InitialRule, shows: bool) -> _Part:
    """By the rule of a file; what adds to operators that show the angle shows none."""

    def states(commands: Vec, angles: Vec) -> Vec:
        seen = angles if shows else np.zeros_like(angles)
        state = rule.state(seen[:, None], commands[:, None])
        return np.array(np.broadcast_to(state, (commands.size, len(rule.offset))))

    return states
