"""The units around a network, which itself works on numbers of about one."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class Scaling:
    """Units in, units out: v = (u - u_offset) / u_scale, theta = theta_offset + theta_scale * y.

    For an inverse map `u` is the angle and `theta` the command.

    Attributes:
        u_offset, u_scale: in the unit of what goes in [mm or bar].
        theta_offset, theta_scale: in the unit of what comes out [deg].

    Raises:
        ModelError: if a number is not finite or a scale not positive.
    """

    u_offset: float = 0.0
    u_scale: float = 6.0
    theta_offset: float = 0.0
    theta_scale: float = 90.0

    def __post_init__(self) -> None:
        values = [getattr(self, f.name) for f in fields(self)]
        if not np.isfinite(values).all() or self.u_scale <= 0 or self.theta_scale <= 0:
            raise ModelError(f"network scaling: got {values}, expected finite numbers and scales > 0")

    def scale_in(self, u: Vec) -> Vec:
        """Scaled input v."""
        return (u - self.u_offset) / self.u_scale

    def scale_out(self, theta: Vec) -> Vec:
        """Scaled output y that stands for `theta`."""
        return (theta - self.theta_offset) / self.theta_scale

    def to_units(self, y: Vec) -> Vec:
        """Output `theta` of a scaled output y."""
        return self.theta_offset + self.theta_scale * y
