"""A predictor whose one-step inverse is exact."""

from __future__ import annotations

from abc import abstractmethod

from ..model import Array, Predictor


class InvertiblePredictor(Predictor):
    """A predictor of a model whose angle does not fall with the command, with a fast search for the command."""

    @abstractmethod
    def command_for(self, state: Array, theta: float, low: float, high: float, last: float) -> float:
        """Command in [low, high] after which the angle is `theta` [deg], exact to 1e-11; see `CompiledInverse`."""
