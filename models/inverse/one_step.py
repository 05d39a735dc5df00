"""The exact one-step inverse of a compiled model."""

from __future__ import annotations

from typing import final

from ..model import Array, Inverse
from ..prediction.invertible import InvertiblePredictor


@final
class CompiledInverse(Inverse):
    """Exact one-step inverse of a compiled model whose angle does not fall with the command.

    u = argmin |u - u_last| over { u in [low, high] : theta(x, u) = theta }, by Newton's method on the exact
    derivative inside a shrinking bracket; the end of the range where no command reaches the angle. For a backlash it
    is S2 eq. (3), for a Prandtl-Ishlinskii model the analytic inverse with the true rate of the command.
    """

    def __init__(self, predictor: InvertiblePredictor, low: float, high: float) -> None:
        self.predictor, self.low, self.high = predictor, low, high

    def command(self, state: Array, theta: float, u_last: float) -> float:
        return self.predictor.command_for(state, theta, self.low, self.high, u_last)
