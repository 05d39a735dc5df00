"""S2's bench with its tendon catheter on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from .device import Device
from .tendon import TendonCatheter, TendonParameters, TendonVariation
from .tracked_bench import TrackedBench


@final
@dataclass(frozen=True, kw_only=True)
class TendonRecorder(TrackedBench):
    """The bench of S2.

    Attributes:
        device: the catheter.
        variation: how it differs from trial to trial.
    """

    device: TendonParameters = field(default_factory=TendonParameters)
    variation: TendonVariation = field(default_factory=TendonVariation)

    def mounted(self, random: np.random.Generator) -> Device:
        return TendonCatheter(self.variation(self.device, random))
