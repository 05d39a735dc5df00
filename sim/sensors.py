"""What sensors make of the true angle: a chain of its own behind the device, so that they never change it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.operators.measurement import Sensor
from hystmpc.trials.types import Vec

_STEP = np.array([1.0])  # sensors have no time in them


@final
class SensorChain:
    """Sensors one after another, with explicit state; none at all shows the angle itself.

    Args:
        sensors: in the order in which the angle passes them.
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)
        if self._sensors:
            chain = Chain(self._sensors[0], after=self._sensors[1:])
            self._values, self._kernels = chain.values, compile_step(chain.transition)

    def start(self, angle: float, seed: int) -> Vec:
        """State (S,) at a true angle [deg]; `seed` is mixed into the seed of every sensor."""
        states = [
            np.asarray(sensor.reseeded(_mixed(sensor.seed, seed, k)).at_rest(angle, angle, sensor.values)).ravel()
            for k, sensor in enumerate(self._sensors)
        ]
        return np.concatenate([np.empty(0), *states])

    def show(self, state: Vec, angle: float) -> tuple[float, Vec]:
        """What is shown of a true angle [deg], and the next state."""
        if not self._sensors:
            return angle, state
        following, shown = state.reshape(1, -1).copy(), np.empty((1, 1))
        constants = self._kernels.step_constants
        self._kernels.simulate(following, np.array([[angle]]), self._values, _STEP, constants, shown)
        return float(shown[0, 0]), following[0]


def _mixed(own: int, seed: int, k: int) -> int:
    """A seed for sensor number `k`; the generator mixes neighbouring seeds itself."""
    return (own + 1_000_003 * (seed + 7919 * k)) % 2**63
