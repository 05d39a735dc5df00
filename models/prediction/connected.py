"""Predictors of models in series and in parallel: a drive before a model, a chain of operators beside a network."""

from __future__ import annotations

from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..inverse.drive import Drive
from ..model import Predictor


@final
class SeriesPredictor(Predictor):
    """A model whose command first passes a drive: theta = model(v), v = drive(u).

    d theta / d u = (d theta / d v) (d v / d u). The state is [drive state, model state].

    Args:
        drive: dynamics between command and travel.
        predictor: of the model that answers to the travel v.
    """

    def __init__(self, drive: Drive, predictor: Predictor) -> None:
        self.dt, self.command_range, self.noise = predictor.dt, predictor.command_range, predictor.noise
        self.model_sigma_deg = predictor.model_sigma_deg
        self._drive, self._size, self._predictor = drive.predictor, drive.size, predictor

    def initial(self, y: float, u: float) -> Vec:
        return np.concatenate([self._drive.initial(u, u), self._predictor.initial(y, u)])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        v, moved = self._drive.advance(state[: self._size], u)
        theta, following = self._predictor.advance(state[self._size :], v)
        return theta, np.concatenate([moved, following])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._predictor.rollout(state[self._size :], self._drive.rollout(state[: self._size], plans))

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        travel, by_command = self._drive.linearise(state[: self._size], plan)
        theta, by_travel = self._predictor.linearise(state[self._size :], travel)
        return theta, by_travel @ by_command


@final
class ParallelPredictor(Predictor):
    """Two models that see the same command, their angles added: theta = first(u) + second(u).

    The state is [state of the first, state of the second]. At rest the first one shows the measured angle.

    Args:
        first: of the model that stands for the device.
        second: of the model of what the first one leaves.
    """

    def __init__(self, first: Predictor, second: Predictor) -> None:
        self.dt, self.command_range, self.noise = first.dt, first.command_range, second.noise
        self.model_sigma_deg = second.model_sigma_deg
        self.first, self.second = first, second
        self.size = first.initial(0.0, first.command_range[0]).size

    def initial(self, y: float, u: float) -> Vec:
        return np.concatenate([self.first.initial(y, u), self.second.initial(0.0, u)])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        main, moved = self.first.advance(state[: self.size], u)
        rest, following = self.second.advance(state[self.size :], u)
        return main + rest, np.concatenate([moved, following])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self.first.rollout(state[: self.size], plans) + self.second.rollout(state[self.size :], plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        main, by_main = self.first.linearise(state[: self.size], plan)
        rest, by_rest = self.second.linearise(state[self.size :], plan)
        return main + rest, by_main + by_rest
