"""A controller's law that knows when there is no time left: the ladder then answers in its place."""

from __future__ import annotations

from typing import Any, final

from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law import Law, Proposal, Situation
from hystmpc.ctrl.stopwatch import Stopwatch


class NoTimeError(Exception):
    """There is no time for a plan; never leaves the controller's step."""


@final
class TimelyLaw(Law[Any]):
    """The same law, but failing at once where `refusal` says why: shifted plan, inverse, hold, stop are next.

    Args:
        law: what the controller wants.
    """

    def __init__(self, law: Law[Any]) -> None:
        self._law = law
        self.horizon, self.source = law.horizon, law.source
        self.refusal = ""

    def init(self, y: float, u: float) -> Any:
        """Memory at rest."""
        return self._law.init(y, u)

    def propose(self, memory: Any, situation: Situation, watch: Stopwatch) -> Proposal[Any]:
        """The wanted command."""
        if self.refusal:
            raise NoTimeError(self.refusal)
        return self._law.propose(memory, situation, watch)


def timely(controller: GuardedController[Any]) -> tuple[GuardedController[Any], TimelyLaw]:
    """The same controller around a law that can be told to fail, and that law: only failing leads to the ladder."""
    law = TimelyLaw(controller.law)
    return controller.with_law(law), law
