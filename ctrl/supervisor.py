"""Supervisory switching with bumpless transfer: predictive control where the model predicts well, else feedback."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, final

from hystmpc.models.model import Inverse, Predictor, static_gain

from .command import CommandLimits, ControlInput, Source, Stopwatch, attempt, replace
from .feedback import InverseFeedforward, InversePid, Pid, PidFeedback, PidSettings
from .law import Law, Proposal
from .planning_settings import SupervisorSettings

SupervisorLevel = Literal["mpc", "inverse_pid", "pid"]
LEVELS: tuple[SupervisorLevel, ...] = ("mpc", "inverse_pid", "pid")

_BACK = 0.5  # share of a threshold below which a better level takes over again
_KP_SHARE, _KI_PER_S = 0.2, 1.5  # of gains that nobody has tuned, in units of the inverse of the model's static gain


def feedback_gains(settings: SupervisorSettings, predictor: Predictor) -> PidSettings:
    """The gains of both feedback laws, for a model."""
    if settings.pid is not None:
        return settings.pid
    gain = attempt(lambda: static_gain(predictor))[0] or 0.0
    gains = PidSettings()
    if gain > 0:
        gains = PidSettings(kp_per_deg=_KP_SHARE / gain, ki_per_deg_s=_KI_PER_S / gain)
    return gains if predictor.noise is None else gains.with_dead_zone(predictor.noise.sensor_resolution_deg)


def supervisory_law(
    mpc: Law[Any],
    settings: SupervisorSettings,
    pair: tuple[Predictor, Inverse],
    limits: CommandLimits,
) -> SupervisoryLaw:
    """The predictive law with the two feedback laws that a supervisor switches to, on one model.

    The inverse is that of the hysteresis alone, sample by sample: where a model predicts so badly, inverting its lag
    and delay gains nothing.
    """
    predictor, inverse = pair
    pid = Pid(feedback_gains(settings, predictor), limits, predictor.dt)
    feedback = InversePid(InverseFeedforward(inverse), pid, predictor, limits), PidFeedback(pid, limits)
    return SupervisoryLaw(mpc, *feedback, (settings.inverse_pid_above, settings.pid_above))


@dataclass(frozen=True, eq=False)
class SupervisorMemory:
    """The level that acts, and the memory of its law."""

    level: SupervisorLevel
    inner: Any


@final
class SupervisoryLaw(Law[SupervisorMemory]):
    """Supervisory control: one of three laws acts, chosen by the error of the forecasts, with bumpless transfer.

    The supervisor switches to a lower level as soon as the error exceeds the threshold of the present one, and back
    once it is below half of that threshold (hysteresis).
    """

    source = Source.MPC

    def __init__(
        self, mpc: Law[Any], inverse_pid: InversePid, pid: PidFeedback, thresholds: tuple[float, float]
    ) -> None:
        self.horizon = max(mpc.horizon, inverse_pid.horizon, pid.horizon)
        self._mpc, self._inverse_pid, self._pid = mpc, inverse_pid, pid
        self._laws: dict[SupervisorLevel, Law[Any]] = {"mpc": mpc, "inverse_pid": inverse_pid, "pid": pid}
        self._thresholds = thresholds

    def init(self, y: float, u: float) -> SupervisorMemory:
        return SupervisorMemory("mpc", self._mpc.init(y, u))

    def propose(self, memory: SupervisorMemory, given: ControlInput, watch: Stopwatch) -> Proposal[SupervisorMemory]:
        level = self._level(memory.level, given.forecast_error)
        if level != memory.level:
            memory = SupervisorMemory(level, self._bumpless_start(level, given))
        law = self._laws[level]
        proposed = law.propose(memory.inner, replace(given, reference=given.reference[: law.horizon]), watch)
        status = proposed.status
        if level != "mpc":
            note = f"{level}: forecasts are off by {100 * given.forecast_error:.0f} % of the motion"
            status = note if status == "ok" else f"{note}; {status}"
        return Proposal(
            proposed.u, SupervisorMemory(level, proposed.memory), proposed.plan, proposed.predicted, status, law.source
        )

    def _level(self, now: SupervisorLevel, forecast_error: float) -> SupervisorLevel:
        """The level at this error of the forecasts; better than the present one only where it is clearly lower."""
        at = LEVELS.index(now)
        worst = sum(forecast_error > threshold for threshold in self._thresholds)
        best = sum(forecast_error > _BACK * threshold for threshold in self._thresholds)
        return LEVELS[max(worst, min(at, best))]

    def _bumpless_start(self, level: SupervisorLevel, given: ControlInput) -> Any:
        if level == "mpc":
            return self._mpc.init(given.measured, given.u_last)
        return self._inverse_pid.bumpless_start(given) if level == "inverse_pid" else self._pid.bumpless_start(given)
