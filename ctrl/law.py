"""Control law written in Python: its interface, its settings, and the law as the engine calls it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from threading import local
from typing import Any, ClassVar, Generic, TypeVar, final

import numpy as np

from hystmpc.core.outside import keep_fault, numbers_at
from hystmpc.core.structs import constants, layout
from hystmpc.trials.config import Count, NotNegativeInt, Settings
from hystmpc.trials.types import Vec

from .command import EMPTY, ControlInput, LimitsSettings, Source, Stopwatch
from .estimation.observer import SensorKindSettings

M = TypeVar("M")


@dataclass(frozen=True, eq=False)
class Proposal(Generic[M]):
    """Proposed command, next memory, plan (`predicted` without disturbance) and level; None for the law's level."""

    u: float
    memory: M
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    status: str = "ok"
    source: Source | None = None


class Law(ABC, Generic[M]):
    """Control law with explicit memory; it may raise, and propose commands beyond the limits."""

    horizon: int  # reference samples that the law uses
    source: Source

    @abstractmethod
    def init(self, y: float, u: float) -> M:
        """Return the memory at rest with measured angle `y` [deg] and held command `u`."""

    @abstractmethod
    def propose(self, memory: M, given: ControlInput, watch: Stopwatch) -> Proposal[M]:
        """Propose a command; the time of each stage is recorded in `watch`."""


class FallbackSettings(Settings):
    """Block `ladder`: conditions for prediction, fallback and stop.

    Attributes:
        stop_after_failures: consecutive failed samples after which the stop is latched.
        max_missing_samples: consecutive samples without usable measurement that are bridged by prediction.
        safe_command: where a stop goes, within the rate limit [mm or bar]; null stays at the last command.
    """

    stop_after_failures: Count = 25
    max_missing_samples: NotNegativeInt = 25
    safe_command: float | None = None


class LawSettings(Settings):
    """Base class of the settings of every kind of controller.

    An external class builds its parts itself. It defines

        law(predictor, inverse, limits) -> Law
        observer(predictor) -> Observer, as `EstimatorSettings.observer` gives one
        model_pair(predictor, inverse) -> (predictor, inverse), where it does not work with these two as they are

    Attributes:
        limits: may only narrow those of the device; null takes them as they are.
        ladder: when prediction, fallback and stop set in.
        estimator: how the measurements come.
    """

    falls_back_on_inverse: ClassVar[bool] = True
    predicts: ClassVar[bool] = (
        False  # whether the law predicts with the model itself; others get an operator in place of a network
    )

    limits: LimitsSettings | None = None
    ladder: FallbackSettings = FallbackSettings()
    estimator: SensorKindSettings = SensorKindSettings()

    def resolved(self) -> LawSettings:
        """Return these settings, or those of the external class that they name."""
        return self

    def bridged_samples(self, dt_s: float) -> int:
        """Number of consecutive samples without a usable measurement that are bridged, at sample time `dt_s` [s]."""
        usual = self.ladder.max_missing_samples
        return usual if hasattr(self, "law") else self.estimator.bridged_samples(usual, dt_s)


@final
class LawPart:
    """A law written in Python as the engine calls it: `propose` of `hystmpc_control_law` in core/controller.h.

    The memory of the law stands beside that of the engine: `begin` gives the present one, `after` the next.

    Args:
        law: with an explicit memory.
        states: numbers of the state that it is given.
    """

    def __init__(self, law: Law[Any], states: int) -> None:
        self.law, self._states, self._local = law, states, local()

    def begin(self, memory: Any) -> None:
        """Set the memory with which the next sample is proposed."""
        self._local.memory, self._local.answer = memory, None

    @property
    def answer(self) -> Proposal[Any] | None:
        """Proposal of this sample; None where the law failed, or was not asked."""
        answer: Proposal[Any] | None = getattr(self._local, "answer", None)
        return answer

    def __call__(self, given: int, proposal: int) -> int:
        """Ask the law; 0, or 1 where it raises or answers no proposal."""
        try:
            with np.errstate(all="ignore"):
                self._ask(_GIVEN.from_address(given), _PROPOSAL.from_address(proposal))
        except BaseException as error:  # noqa: BLE001 - through C no exception passes
            keep_fault(error)
            return 1
        return 0

    def _ask(self, asked: Any, out: Any) -> None:
        answer = self.law.propose(self._local.memory, self._input(asked), Stopwatch())
        plan, foreseen = (
            np.asarray(one, dtype=np.float64)[: self.law.horizon] for one in (answer.plan, answer.predicted)
        )
        if plan.ndim != 1 or foreseen.ndim != 1:
            raise ValueError(f"law: got a plan of shape {plan.shape}, angles of {foreseen.shape}, expected (H,) each")
        known = min(plan.size, foreseen.size)
        out.u, out.planned = float(answer.u), plan.size
        out.source = _SOURCES[answer.source or self.law.source]
        if plan.size:
            numbers_at(out.commands, plan.size)[:] = plan
            angles = numbers_at(out.angles, plan.size)
            angles[:known], angles[known:] = foreseen[:known], math.nan
        self._local.answer = answer

    def _input(self, asked: Any) -> ControlInput:
        return ControlInput(
            state=numbers_at(asked.state, self._states).copy(),
            disturbance=asked.disturbance,
            disturbance_sigma=asked.sigma,
            measured=asked.measured,
            age=asked.age,
            u_last=asked.u_last,
            due=asked.due,
            setpoint=asked.setpoint,
            reference=numbers_at(asked.reference, self.law.horizon).copy(),
            remaining_plan=numbers_at(asked.remaining, asked.planned).copy(),
            forecast_error=asked.forecast_error,
        )


_GIVEN, _PROPOSAL = layout("hystmpc_given"), layout("hystmpc_proposal")
_SOURCES = {
    source: constants()[f"HYSTMPC_{name}"]
    for source, name in {
        Source.MPC: "MPC",
        Source.CONTROLLER: "FEEDBACK",
        Source.SHIFTED_PLAN: "SHIFTED_PLAN",
        Source.INVERSE: "INVERSE",
        Source.HOLD: "HOLD",
        Source.STOP: "STOP",
    }.items()
}
