"""The inverse of a model with a learned part, along a horizon."""

from __future__ import annotations

from typing import final

from hystmpc.models.inverse.follow import Bounds, Follower, follower_for
from hystmpc.trials.types import Vec

from .predictor import LearnedInverse

_ROUNDS = 2


@final
class LearnedFollower(Follower):
    """The model's inverse followed at the angles less the learned part, first as it is at present, then as along the
    plan found: a fixed point where the learned part is the smaller one.
    """

    def __init__(self, inverse: LearnedInverse) -> None:
        self._predictor = inverse.predictor
        self._inner = follower_for(inverse.predictor.model, inverse.inverse)

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        predictor = self._predictor
        below = predictor.below(state)
        targets = self._inner.follow(below, wanted - predictor.rest(state), u_last, bounds)
        for _ in range(_ROUNDS):
            plan = targets[1:]
            targets = self._inner.follow(below, wanted - predictor.learned(state, plan)[0], u_last, bounds)
        return targets
