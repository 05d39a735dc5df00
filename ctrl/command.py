"""What a controller answers at every step: the command, where it came from, what it expects and what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from hystmpc.trials.types import Vec

EMPTY: Vec = np.empty(0)
EMPTY.setflags(write=False)


class Source(StrEnum):
    """The rung of the ladder that produced a command, best first."""

    CONTROLLER = "controller"  # feedforward or feedback law
    MPC = "mpc"
    SHIFTED_PLAN = "shifted plan"
    INVERSE = "inverse"
    HOLD = "hold"
    STOP = "stop"


@dataclass(frozen=True)
class Timing:
    """Time spent per stage of one step [s]; absent stages are missing from the mapping."""

    stages: Mapping[str, float] = field(default_factory=dict)

    @property
    def total_s(self) -> float:
        """Sum over the stages [s]."""
        return sum(self.stages.values())


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Command:
    """One command to the device.

    Attributes:
        u: command [mm or bar], always finite and within the limits on value and rate.
        source: which rung of the ladder produced it.
        status: `ok`, or one line on what was unusual or why a better rung was not used.
        plan: planned commands over the horizon, shape (H,), empty where the controller does not plan.
        predicted: predicted tip angles [deg] at the ends of this and the next samples, disturbance included: as
            many as the plan has, up to the effect of `u` where there is no plan, none without a model.
        disturbance: estimated output disturbance [deg].
        timing: time per stage.
    """

    u: float
    source: Source
    status: str = "ok"
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    disturbance: float = 0.0
    timing: Timing = field(default_factory=Timing)
