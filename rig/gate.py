"""The last line before the device: hard limits, whatever anybody upstream has decided."""

from __future__ import annotations

import math
from typing import final

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trials.errors import ConfigError


@final
class Gate:
    """Admits commands within the limits on value and rate, measured from the command really sent.

    Args:
        limits: of the device.
        dt_s: sample time [s].
        held: the command that the device holds now.

    Raises:
        ConfigError: if the device is outside the limits already.
    """

    def __init__(self, limits: CommandLimits, dt_s: float, held: float) -> None:
        if not (math.isfinite(held) and limits.lower <= held <= limits.upper):
            raise ConfigError(
                f"start: the device holds command {held}, expected one within {limits.lower} to {limits.upper}; "
                "move it there by hand or correct the limits"
            )
        self._limits, self._dt = limits, dt_s
        self.last = held
        self.velocity = 0.0
        self.clipped = 0

    def admit(self, wanted: float) -> float:
        """The admissible command nearest to the wanted one, which counts as sent; never raises."""
        u = self._limits.clip(wanted, self.last, self._dt)
        self.clipped += not abs(u - wanted) <= 1e-12
        self.velocity = (u - self.last) / self._dt
        self.last = u
        return u
