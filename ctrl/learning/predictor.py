"""A model with its learned part: predictor, inverse and follower."""

from __future__ import annotations

from typing import final

import numpy as np

from hystmpc.models.inverse.follow import Bounds, Follower, follower_for
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from ..analysis import static_gain
from ..fallback import attempt
from ..planning_settings import AdaptationSettings
from .bank import BankState, FilterBank
from .basis import DELAYS, FEATURES, MEMORY, add_learned, add_slopes, advance_memory, first_memory

_ROUNDS = 2
_RANGE_DEG = 60.0  # angle over the range of a model that does not say it [deg]
_SENSOR_DEG = 0.1  # standard deviation of a sensor of which the model's file says nothing [deg]
_OWN = MEMORY + DELAYS + 1 + FEATURES + 5


@final
class LearnedPredictor(Predictor):
    """theta = m + w_c (m - m_0) + sum_i w_i f_i, see `basis`; the weights stand still in a roll-out.

    Where all weights are zero this is the model. The state is the model's, then memory (MEMORY,), queue (DELAYS,),
    weights (1 + FEATURES,), v0, side, m_0, share of the lag in a sample, delay [samples].
    """

    def __init__(self, model: Predictor, settings: AdaptationSettings) -> None:
        self.dt, self.command_range, self.noise, self.model = model.dt, model.command_range, model.noise, model
        low, high = model.command_range
        self.slope = attempt(lambda: static_gain(model))[0] or _RANGE_DEG / (high - low)  # a model may fail
        self._settings, self._low, self._span = settings, low, high - low
        self._bank = self.filters(0)

    def filters(self, delay: int) -> FilterBank:
        """The bank that learns the weights, behind `delay` samples of delay that the model does not have."""
        sensor = _SENSOR_DEG if self.noise is None else self.noise.sensor_sigma_deg
        scale = self.slope * self._span
        return FilterBank(self.dt, self.command_range, scale, sensor, delay, self._settings)

    def initial(self, y: float, u: float) -> Vec:
        v = (u - self._low) / self._span
        side = 1.0 if v < 0.5 else -1.0
        own = [first_memory(v, side), np.full(DELAYS, v), np.zeros(1 + FEATURES), [v, side, y, 1.0, 0.0]]
        return np.concatenate([self.model.initial(y, u), *own])

    def with_learned(self, below: Vec, bank: BankState) -> Vec:
        """The model's state `below` with the learned part of a bank whose newest memory is of the same instant."""
        weights, start = bank.weights, [*bank.start, self._bank.lags[bank.lag], float(bank.delay)]
        return np.concatenate([below, bank.history[bank.delay, bank.lag], bank.queue, weights, start])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        angle, below = self.model.advance(self.below(state), u)
        memory, waiting, weights, start, steps = self._parts(state)
        x, angles = (u - self._low) / self._span, np.array([[angle]])
        add_learned(memory, waiting, weights, start, steps, self._bank.creeps, np.array([[x]]), angles)
        after = state[state.size - _OWN :].copy()
        advance_memory(after[:MEMORY], waiting[0] if waiting.size else x, steps[0], self._bank.creeps)
        after[MEMORY + 1 : MEMORY + DELAYS] = after[MEMORY : MEMORY + DELAYS - 1].copy()
        after[MEMORY] = x
        return float(angles[0, 0]), np.concatenate([below, after])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        angles = np.ascontiguousarray(self.model.rollout(self.below(state), plans))
        self._add(state, plans, angles)
        return angles

    def learned(self, state: Vec, plans: Vec) -> Vec:
        """What the learned part adds (N, H) [deg] along the plans (N, H)."""
        model = self.model.rollout(self.below(state), plans)
        angles = np.array(model, order="C")
        self._add(state, plans, angles)
        return angles - model

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = self.model.linearise(self.below(state), plan)
        angles, jacobian = angles.copy(), np.ascontiguousarray(jacobian) * self._span
        self._add(state, plan[None], angles[None])
        memory, waiting, weights, _, steps = self._parts(state)
        shares = (plan - self._low) / self._span
        add_slopes(memory, waiting, weights, steps, self._bank.creeps, shares, jacobian)
        return angles, jacobian / self._span

    def below(self, state: Vec) -> Vec:
        """The model's own state."""
        return state[: state.size - _OWN]

    def weights(self, state: Vec) -> Vec:
        """w_c and w (1 + FEATURES,) [1 and deg]."""
        return self._parts(state)[2]

    def _add(self, state: Vec, plans: Vec, angles: Vec) -> None:
        """The learned part along the plans (N, H), added to the model's angles (N, H) in place."""
        memory, waiting, weights, start, steps = self._parts(state)
        shares = np.ascontiguousarray((plans - self._low) / self._span)
        add_learned(memory, waiting, weights, start, steps, self._bank.creeps, shares, angles)

    def _parts(self, state: Vec) -> tuple[Vec, Vec, Vec, Vec, Vec]:
        """Memory, commands that have not acted yet (the oldest first), weights, start and steps of `add_learned`."""
        own = state[state.size - _OWN :]
        waiting = np.ascontiguousarray(own[MEMORY : MEMORY + int(own[-1])][::-1])
        weights, start = np.split(own[MEMORY + DELAYS : -2], [1 + FEATURES])
        return own[:MEMORY], waiting, weights, start, np.array([own[-2], 1.0 / self.dt])


@final
class LearnedInverse(Inverse):
    """The model's inverse at the angle less what the learned part adds in a hold; see `LearnedFollower` for plans."""

    def __init__(self, predictor: LearnedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        if not self.predictor.weights(state).any():
            return self.inverse.command(self.predictor.below(state), theta, u_last)
        added = float(self.predictor.learned(state, np.full((1, 1), u_last))[0, 0])
        return self.inverse.command(self.predictor.below(state), theta - added, u_last)


@final
class LearnedFollower(Follower):
    """The model's inverse followed at the angles less the learned part, first as in a hold, then as along the plan
    found: a fixed point where the learned part is the smaller one.
    """

    def __init__(self, inverse: LearnedInverse) -> None:
        self._predictor = inverse.predictor
        self._inner = follower_for(inverse.predictor.model, inverse.inverse)

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        predictor = self._predictor
        below = predictor.below(state)
        if not predictor.weights(state).any():
            return self._inner.follow(below, wanted, u_last, bounds)
        held = np.full((1, wanted.size), u_last)
        targets = self._inner.follow(below, wanted - predictor.learned(state, held)[0], u_last, bounds)
        for _ in range(_ROUNDS):
            plan = targets[1:]
            targets = self._inner.follow(below, wanted - predictor.learned(state, plan)[0], u_last, bounds)
        return targets
