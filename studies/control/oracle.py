"""A predictor that knows what its device went through before the first sample."""

from __future__ import annotations

from typing import final

from hystmpc.models.model import Array, Predictor


@final
class RestedPredictor(Predictor):
    """A predictor whose state at the start is that after some commands, instead of that of a rule.

    The rule of a model puts all plays where they show the measured angle; which of them is where is known only to
    whoever knows the commands before.

    Args:
        predictor: the model.
        before: commands (T,) that the device got before the first sample, the last of them its rest.
    """

    def __init__(self, predictor: Predictor, before: Array) -> None:
        self.dt, self.command_range = predictor.dt, predictor.command_range
        self._predictor, self._before = predictor, before

    def initial(self, y: float, u: float) -> Array:
        state = self._predictor.initial(y, u)
        for command in self._before:
            _, state = self._predictor.advance(state, float(command))
        return state

    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        return self._predictor.advance(state, u)

    def rollout(self, state: Array, plans: Array) -> Array:
        return self._predictor.rollout(state, plans)

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        return self._predictor.linearise(state, plan)
