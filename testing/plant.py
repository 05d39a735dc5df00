"""What every device behind the closed loop owes: a contract that a lab runs against its own simulator or device."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from hystmpc.ctrl.loop import Plant
from hystmpc.trials.types import Vec

from .wire import require


class PlantContract(ABC):
    """Derive a class whose name begins with `Test`, give it `plant`, and run pytest. A real device moves meanwhile.

    Attributes:
        low, high: ends of the command's range that the tests may use [mm or bar].
        noise_deg: greatest difference between two readings of one angle [deg].
    """

    low: float = 0.0
    high: float = 6.0
    noise_deg: float = 1e-9

    @abstractmethod
    def plant(self) -> Plant:
        """The plant that is tested."""

    def test_a_reset_finds_it_at_rest_and_the_same_each_time(self) -> None:
        """The same commands give the same angles, whatever was done before the reset."""
        first, again = self._motion(), self._motion()
        off = float(np.max(np.abs(first - again)))
        require(off <= self.noise_deg, f"the same motion after a reset differs by {off:.3g} deg")

    def test_its_sample_time_is_a_time(self) -> None:
        """Positive and finite [s]."""
        require(0.0 < self._plant.dt < math.inf, f"dt is {self._plant.dt} s")

    def test_every_command_is_answered_by_a_finite_angle(self) -> None:
        """Moves and jumps over the whole range."""
        angles = self._motion()
        require(bool(np.all(np.isfinite(angles))), "an angle is not finite")

    def test_it_moves(self) -> None:
        """The angle follows the command by more than the noise."""
        moved = float(np.ptp(self._motion()))
        require(moved > 3.0 * self.noise_deg, f"the angle moves by {moved:.3g} deg over the whole range")

    def test_stop_is_allowed_at_any_time_and_twice(self) -> None:
        """Before the first reset, in motion, and again; a reset then begins anew."""
        plant = self.plant()
        plant.stop()
        first = plant.reset()
        for _ in range(5):
            plant.apply(self.high)
        plant.stop()
        plant.stop()
        off = abs(plant.reset() - first)
        require(off <= self.noise_deg, f"after a stop a reset finds it {off:.3g} deg away")

    @cached_property
    def _plant(self) -> Plant:
        return self.plant()

    def _motion(self) -> Vec:
        """Angles (T,) from a reset on [deg]; the plant is stopped behind it."""
        k = np.arange(60)
        share = np.where(k < 40, 0.5 - 0.5 * np.cos(0.3 * k), k % 2)
        try:
            first = self._plant.reset()
            return np.array([first, *(self._plant.apply(float(u)) for u in self.low + (self.high - self.low) * share)])
        finally:
            self._plant.stop()
