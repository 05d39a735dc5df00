"""A control law: what a controller wants, before limits and fallbacks; and the settings that build one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import Count, NotNegativeInt, Settings
from hystmpc.trials.types import Vec

from .command import EMPTY, CommandLimits, ControlInput, LimitsSettings, Source, Stopwatch
from .estimation.observer import Observer, SensorKindSettings

M = TypeVar("M")


@dataclass(frozen=True, eq=False)
class Proposal(Generic[M]):
    """A wanted command, the law's next memory, and the plan behind it (`predicted` without disturbance).

    `source` is the level that the command comes from, None for that of the law.
    """

    u: float
    memory: M
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    status: str = "ok"
    source: Source | None = None


class Law(ABC, Generic[M]):
    """Memory in, memory out. A law may raise and may want anything: `GuardedController` makes it safe."""

    horizon: int  # reference samples looked at
    source: Source

    @abstractmethod
    def init(self, y: float, u: float) -> M:
        """Memory at rest with measured angle `y` [deg] and held command `u`."""

    @abstractmethod
    def propose(self, memory: M, given: ControlInput, watch: Stopwatch) -> Proposal[M]:
        """The wanted command; stages worth telling apart are booked on `watch`."""


class FallbackSettings(Settings):
    """Block `ladder`: when prediction, fallback and stop set in.

    Attributes:
        stop_after_failures: consecutive failed samples after which the stop is latched.
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.
        safe_command: where a stop goes, within the rate limit [mm or bar]; null stays at the last command.
    """

    stop_after_failures: Count = 25
    max_missing_samples: NotNegativeInt = 25
    safe_command: float | None = None


class LawSettings(Settings):
    """Base of the settings of every kind of controller: they build its law and its observer.

    Attributes:
        limits: may only narrow those of the device; null takes them as they are.
        ladder: when prediction, fallback and stop set in.
        estimator: how the measurements come.
    """

    falls_back_on_inverse: ClassVar[bool] = True
    predicts: ClassVar[bool] = False  # with the model itself; others get an operator in the place of a network

    limits: LimitsSettings | None = None
    ladder: FallbackSettings = FallbackSettings()
    estimator: SensorKindSettings = SensorKindSettings()

    def resolved(self) -> LawSettings:
        """These settings, or those of the class from outside that they name."""
        return self

    def model_pair(self, predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
        """The model and its inverse as the controller uses them, with a learned part where the settings ask for one.

        Who predicts from a controller's own state, as `TipController.predict` does, needs this predictor.
        """
        return predictor, inverse

    def bridged_samples(self, dt_s: float) -> int:
        """Consecutive samples without a usable measurement that are bridged by prediction at sample time `dt_s` [s]."""
        del dt_s
        return self.ladder.max_missing_samples

    @abstractmethod
    def observer(self, predictor: Predictor) -> Observer:
        """The estimator of state and disturbance."""

    @abstractmethod
    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
        """The control law."""
