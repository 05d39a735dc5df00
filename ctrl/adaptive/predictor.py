"""A model with a learned part on top: a predictor like any other, the learned weights in its state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..slope import mean_slope
from .kernels import add_learned, add_slopes


@dataclass(frozen=True)
class LearnedOptions:
    """The shape of the learned part.

    Attributes:
        plays: number of plays K beside the straight line.
        widest: half-width of the widest, as a share of the command's range; the others divide it evenly.
        lag_s: first-order lag between command and travel [s], 0 for none.

    Raises:
        ControllerError: if a value is out of bounds.
    """

    plays: int = 6
    widest: float = 0.2
    lag_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.plays >= 0 and 0 < self.widest <= 1 and math.isfinite(self.lag_s) and self.lag_s >= 0):
            raise ControllerError(f"adaptation: got {self}, expected plays >= 0, widest in (0, 1], lag_s >= 0")


@final
class LearnedPredictor(Predictor):
    """theta = model(u) + w_0 (v - v_0) + sum_i w_i (p_i - p_i0) + w_v d model / dt.

    v is the command behind the lag, p_i plays of half-width r_i on v: a Prandtl-Ishlinskii operator whose weights may
    have either sign, since it is added to a model that is nearly right. The last term is what a lag or delay slightly
    other than the model's leaves over, to first order. The weights stand still in a roll-out; an estimator changes
    them. Where all are zero, this is the model.

    The state is [model state, p (K), v, model angle, v_0, side, w (K + 2)].

    Args:
        model: what is nearly right.
        options: the shape of the learned part.
    """

    def __init__(self, model: Predictor, options: LearnedOptions) -> None:
        self.dt, self.command_range, self.model = model.dt, model.command_range, model
        low, high = model.command_range
        self.radii = (high - low) * options.widest * np.arange(1, options.plays + 1) / max(options.plays, 1)
        self.gain = 1.0 if options.lag_s == 0 else 1.0 - math.exp(-model.dt / options.lag_s)
        self.size = options.plays + 2
        self._pace = 1.0 / model.dt
        self.slope = mean_slope(model)
        self._own = options.plays + 4 + self.size

    def initial(self, y: float, u: float) -> Vec:
        base = self.model.initial(y, u)
        low, high = self.command_range
        # a device that rests near one end of its command has come from the other side
        side = 1.0 if u < 0.5 * (low + high) else -1.0
        return np.concatenate([base, u + side * self.radii, [u, y, u, side], np.zeros(self.size)])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        angle, below = self.model.advance(self.below(state), u)
        own, count = self._part(state).copy(), self.radii.size
        v = own[count] + self.gain * (u - own[count])
        own[:count] = np.clip(own[:count], v - self.radii, v + self.radii)
        own[count], own[count + 1] = v, angle
        following = np.concatenate([below, own])
        return float(angle + self.features(following, state) @ self.weights(state)), following

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
        angles, jacobian = angles.copy(), np.ascontiguousarray(jacobian).copy()
        self._add(state, plan[None], angles[None])
        plays, travel, _ = self._memory(state)
        add_slopes(plays, self.radii, self.weights(state), travel, self.gain, self._pace, plan, jacobian)
        return angles, jacobian

    def below(self, state: Vec) -> Vec:
        """The model's own state."""
        return state[: state.size - self._own]

    def weights(self, state: Vec) -> Vec:
        """w (K + 2) [deg per command unit; the last in s]."""
        return state[state.size - self.size :]

    def with_weights(self, state: Vec, weights: Vec) -> Vec:
        """The state with other weights."""
        return np.concatenate([state[: state.size - self.size], weights])

    def features(self, state: Vec, before: Vec) -> Vec:
        """What the weights are multiplied by (K + 2) in a state that follows another."""
        own, count = self._part(state), self.radii.size
        rate = (own[count + 1] - self._part(before)[count + 1]) * self._pace
        v0, side = own[count + 2], own[count + 3]
        return np.concatenate([[own[count] - v0], own[:count] - v0 - side * self.radii, [rate]])

    def rest(self, state: Vec) -> float:
        """What the learned part adds to the model at rest in a state [deg]."""
        return float(self.features(state, state) @ self.weights(state))

    def _add(self, state: Vec, plans: Vec, angles: Vec) -> None:
        """The learned part along the plans (N, H), added to the model's angles (N, H) in place."""
        plays, travel, start = self._memory(state)
        add_learned(plays, self.radii, self.weights(state), travel, start, self.gain, self._pace, plans, angles)

    def _part(self, state: Vec) -> Vec:
        return state[state.size - self._own :]

    def _memory(self, state: Vec) -> tuple[Vec, float, Vec]:
        own, count = self._part(state), self.radii.size
        return own[:count], float(own[count]), np.array([own[count + 2], own[count + 3], own[count + 1]])


@final
class LearnedInverse(Inverse):
    """The model's inverse at the angle less what the learned part adds at present; see `LearnedFollower` for plans."""

    def __init__(self, predictor: LearnedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        return self.inverse.command(self.predictor.below(state), theta - self.predictor.rest(state), u_last)
