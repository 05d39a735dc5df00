"""Sizes and effort of a benchmark."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from hystmpc.ctrl.planning import Weights

from .timing import Effort

# Effort is measured from the inverse plan, which peers do not have: without it all solve the same problem.
WEIGHTS = Weights(effort=0.0)

THOROUGH = Effort(rounds=25, burst_s=0.04, burst_most=25)


@dataclass(frozen=True)
class BenchSettings:
    """What is measured.

    Attributes:
        hidden: cells in each of the network's two layers; the goals are for 64.
        horizon: H.
        samples: N of the sampling controller and of the batched roll-outs.
        effort: repetitions.
    """

    hidden: int = 64
    horizon: int = 20
    samples: int = 256
    effort: Effort = THOROUGH

    def plain(self) -> dict[str, Any]:
        """As numbers for the report."""
        return asdict(self)


# The smallest run that still times everything at full size, in turns.
QUICK = BenchSettings(effort=Effort(rounds=3, burst_s=0.01, burst_most=5))
