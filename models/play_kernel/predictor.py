"""Compiled predictions of a play-kernel model; equations in `PlayKernelWeights`, layout in core/play_kernel.h."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.trials.types import Vec

from ..contract.metadata import ModelMetadata
from ..model import InvertiblePredictor
from .weights import PlayKernelWeights

if TYPE_CHECKING:
    from ..contract.load import OnnxModel


def packed_play_kernel(weights: PlayKernelWeights) -> Vec:
    """Model as the one array that the engine reads."""
    levels = np.zeros_like(weights.slopes)
    levels[:, 1:] = np.cumsum(weights.slopes * np.diff(weights.knots), axis=1)[:, :-1]
    stops = np.zeros((2, weights.radii.size)) if weights.stops is None else weights.stops
    numbers = np.array([weights.gain, weights.lower, weights.upper, weights.bias, weights.outer_slope])
    return np.concatenate([np.ravel(a) for a in (numbers, weights.radii, weights.knots, weights.slopes, levels, stops)])


def follow_plays(command: Vec, gain: float, radii: Vec, state: Vec) -> Vec:
    """States (T, 1 + n) after each sample: v += gain (u - v), then p_i = max(v - r_i, min(v + r_i, p_i)).

    Args:
        command: u (T,).
        gain: 1 without a lag.
        radii: r (n,).
        state: v and p before the first sample (1 + n,); not changed.
    """
    states = np.empty((command.size, state.size))
    flat, radii = _contiguous(command, radii)
    engine().follow_plays(flat, flat.size, gain, radii, radii.size, state.copy(), states)
    return states


@final
class PlayKernelPredictor(InvertiblePredictor):
    """Compiled predictor and exact inverse of a play-kernel model; generated kernels would compile for minutes."""

    def __init__(self, weights: PlayKernelWeights, metadata: ModelMetadata) -> None:
        super().__init__(metadata)
        self._model = packed_play_kernel(weights), weights.radii.size, weights.knots.size - 1

    @classmethod
    def of_model(cls, model: OnnxModel) -> PlayKernelPredictor:
        """Predictor of a model file of kind `play_kernel`, from the graph's initializers.

        Raises:
            ModelError: if the initializers are not those of an exported play-kernel model.
        """
        return cls(PlayKernelWeights.from_arrays(model.initializers), model.metadata)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        following = np.array(state, dtype=np.float64)
        return engine().play_kernel_step(*self._model, following, u, None), following

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        theta, (state, plans) = np.empty(plans.shape), _contiguous(state, plans)
        engine().play_kernel_rollout(*self._model, state, plans, *plans.shape, theta, np.empty(state.size))
        return theta

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        theta, jacobian = np.empty(plan.size), np.empty((plan.size, plan.size))
        (state, plan), work = _contiguous(state, plan), np.empty((3 + plan.size) * state.size + 1)
        engine().play_kernel_linearise(*self._model, state, plan, plan.size, theta, jacobian, work)
        return theta, jacobian

    def command_for(self, state: Vec, theta: float, low: float, high: float, last: float) -> float:
        work = np.empty(3 * state.size + 1)
        return float(engine().play_kernel_command(*self._model, *_contiguous(state), theta, low, high, last, work))


def _contiguous(*arrays: Vec) -> tuple[Vec, ...]:
    return tuple(np.ascontiguousarray(array, dtype=np.float64) for array in arrays)
