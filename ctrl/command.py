"""What a control law is given in a step, and what a controller answers: the command, its source, prediction, timing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from time import perf_counter
from typing import final

import numpy as np

from hystmpc.trials.brief import brief
from hystmpc.trials.types import Vec

EMPTY: Vec = np.empty(0)
EMPTY.setflags(write=False)


class Source(StrEnum):
    """The level of fallback that produced a command, best first."""

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
        source: which level of fallback produced it.
        status: `ok`, or one line on what was unusual or why a better level was not used.
        plan: planned commands over the horizon, shape (H,), empty where the controller does not plan.
        predicted: predicted tip angles [deg] at the ends of this and the next samples, disturbance included: as
            many as the plan has, up to the effect of `u` where there is no plan, none without a model.
        disturbance: by how much the device is off the model as it was given [deg]: disturbance and learned part.
        timing: time per stage.
    """

    u: float
    source: Source
    status: str = "ok"
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    disturbance: float = 0.0
    timing: Timing = field(default_factory=Timing)
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class ControlInput:
    """What a law may look at."""

    state: Vec  # predictor state (S,) at the instant at which the next command starts to act
    disturbance: float  # estimated output disturbance [deg]
    disturbance_sigma: float  # standard deviation of what noise does to it in a hold [deg]
    measured: float  # last accepted measurement [deg]
    age: float  # of it [samples], 0 for one of now
    u_last: float  # the command really sent last [mm or bar]
    due: float  # reference angle now [deg]
    setpoint: float  # reference angle at the end of this sample [deg]
    reference: Vec  # reference angles at the ends of the samples that the next commands act in, shape (H,)
    remaining_plan: Vec  # what is left of the last good plan, up to H - 1 entries
    distrust: float = 0.0  # error of the forecasts over that of none, see `Estimate`


@final
class Stopwatch:
    """Laps of one step; the only clock a controller reads."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._since = perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage` [s]."""
        now = perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._since
        self._since = now
