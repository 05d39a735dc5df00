"""A law written in Python, which has no C."""

from typing import Any

from hystmpc.ctrl.law import Law, LawSettings, Proposal


class _OwnLaw(Law[None]):
    horizon = 1

    def init(self, y: float, u: float) -> None:
        del y, u

    def propose(self, memory: None, given: Any, watch: Any) -> Proposal[None]:
        del watch
        return Proposal(given.u_last, memory)


class OwnSettings(LawSettings):
    """Settings of it."""

    def law(self, predictor: object, inverse: object, limits: object) -> Law[None]:
        """Build the law."""
        del predictor, inverse, limits
        return _OwnLaw()
