"""The inverse of a model that has none of its own, through a simulator that runs beside it."""

from __future__ import annotations

from typing import final

import numpy as np

from ..model import Array, Inverse, Predictor


@final
class AccompaniedPredictor(Predictor):
    """A model with a second one at its side that sees the same commands.

    Predictions are the model's. The state is [model state, model angle, companion state, companion angle], so that
    the companion's memory is branched and restored together with the model's.
    """

    def __init__(self, predictor: Predictor, companion: Predictor, angle: float = 0.0) -> None:
        self.dt, self.command_range = predictor.dt, predictor.command_range
        self.predictor, self.companion = predictor, companion
        self.size = predictor.initial(angle, predictor.command_range[0]).size

    def initial(self, y: float, u: float) -> Array:
        # What the two show before their first step is the measured angle for both: no difference is known yet.
        return np.concatenate([self.predictor.initial(y, u), [y], self.companion.initial(y, u), [y]])

    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        own, _, beside, _ = self.parts(state)
        size, after = self.size, np.empty(state.size)
        theta, after[:size] = self.predictor.advance(own, u)
        after[-1], after[size + 1 : -1] = self.companion.advance(beside, u)
        after[size] = theta
        return theta, after

    def rollout(self, state: Array, plans: Array) -> Array:
        return self.predictor.rollout(self.parts(state)[0], plans)

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        return self.predictor.linearise(self.parts(state)[0], plan)

    def parts(self, state: Array) -> tuple[Array, float, Array, float]:
        """Model state, model angle [deg], companion state, companion angle [deg]."""
        return state[: self.size], float(state[self.size]), state[self.size + 1 : -1], float(state[-1])


@final
class CompanionInverse(Inverse):
    """The companion's inverse, asked for the wanted angle less what the companion is off the model by now.

    u = companion^-1(theta + theta_companion - theta_model)
    """

    def __init__(self, predictor: AccompaniedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    def command(self, state: Array, theta: float, u_last: float) -> float:
        _, own, beside, angle = self.predictor.parts(state)
        return self.inverse.command(beside, theta + angle - own, u_last)
