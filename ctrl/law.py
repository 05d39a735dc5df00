"""A control law: what a controller wants, before limits and fallbacks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from hystmpc.trials.types import Vec

from .command import EMPTY, Source
from .stopwatch import Stopwatch

M = TypeVar("M")


@dataclass(frozen=True, eq=False)
class Situation:
    """What a law may look at.

    Attributes:
        state: predictor state (S,) at the instant at which the next command starts to act.
        disturbance: estimated output disturbance [deg].
        disturbance_sigma: standard deviation of its error [deg].
        measured: last accepted measurement [deg].
        u_last: the command really sent last [mm or bar].
        due: the angle that was wanted now [deg].
        setpoint: the angle wanted at the end of this sample [deg].
        reference: the angles wanted at the ends of the samples that the next commands act in, shape (H,).
        remaining_plan: what is left of the last good plan, up to H - 1 entries.
    """

    state: Vec
    disturbance: float
    disturbance_sigma: float
    measured: float
    u_last: float
    due: float
    setpoint: float
    reference: Vec
    remaining_plan: Vec


@dataclass(frozen=True, eq=False)
class Proposal(Generic[M]):
    """A wanted command, the law's next memory, and the plan behind it (`predicted` without disturbance)."""

    u: float
    memory: M
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    status: str = "ok"


class Law(ABC, Generic[M]):
    """Memory in, memory out. A law may raise and may want anything: `GuardedController` makes it safe."""

    horizon: int  # reference samples looked at
    source: Source

    @abstractmethod
    def init(self, y: float, u: float) -> M:
        """Memory at rest with measured angle `y` [deg] and held command `u`."""

    @abstractmethod
    def propose(self, memory: M, situation: Situation, watch: Stopwatch) -> Proposal[M]:
        """The wanted command; stages worth telling apart are booked on `watch`."""
