"""S2's bench with a rod on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from .device import Device
from .rod import RodCatheter
from .rod_parameters import RodParameters, RodVariation
from .tracked_bench import TrackedBench


@final
@dataclass(frozen=True, kw_only=True)
class RodRecorder(TrackedBench):
    """The bench of S2 with a rod in the catheter's place.

    Attributes:
        device: the rod.
        variation: how it differs from trial to trial.
    """

    device: RodParameters = field(default_factory=RodParameters)
    variation: RodVariation = field(default_factory=RodVariation)

    def mounted(self, random: np.random.Generator) -> Device:
        return RodCatheter(self.variation(self.device, random))
