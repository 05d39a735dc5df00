"""Handover: predictive control where the model foretells what is measured, feedback where it does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, final

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import Settings

from .analysis import static_gain
from .command import ControlInput, Source, Stopwatch
from .fallback import attempt
from .feedback.inverse import InverseControllerSettings, InversePid
from .feedback.pid import Pid, PidFeedback, PidSettings
from .law import Law, Proposal
from .limits import CommandLimits, Positive

if TYPE_CHECKING:
    from .estimation.observer import EstimatorSettings

Level = Literal["mpc", "inverse_pid", "pid"]
LEVELS: tuple[Level, ...] = ("mpc", "inverse_pid", "pid")

_BACK = 0.5  # share of a threshold below which a better level takes over again
_KP_SHARE, _KI_PER_S = 0.2, 1.5  # of gains that nobody has tuned, in units of the inverse of the model's static gain


class HandoverSettings(Settings):
    """Block `handover`: which controller acts, by what the forecasts of the last seconds were worth.

    The error of a forecast over 0.24 s is compared with that of no forecast, which is that the angle stays where it is
    (root mean squares, see `FilterBank`).

    Attributes:
        inverse_pid_above: share of the latter from which on inverse and PID take over from the predictive controller.
        pid_above: share from which on the PID alone takes over.
        pid: gains of both; null for 0.2 / G and 1.5 / (G s), where G is the model's static gain [deg per command unit].
    """

    inverse_pid_above: Positive = 0.95
    pid_above: Positive = 1.05
    pid: PidSettings | None = None

    def gains(self, predictor: Predictor) -> PidSettings:
        """The gains, for a model."""
        if self.pid is not None:
            return self.pid
        gain = attempt(lambda: static_gain(predictor))[0] or 0.0
        if not gain > 0:
            return PidSettings()
        return PidSettings(kp_per_deg=_KP_SHARE / gain, ki_per_deg_s=_KI_PER_S / gain)

    def law(
        self,
        mpc: Law[Any],
        pair: tuple[Predictor, Inverse],
        limits: CommandLimits,
        estimator: EstimatorSettings,
    ) -> HandoverLaw:
        """The predictive law with the two that take over from it, on one model."""
        predictor, inverse = pair
        pid = Pid(self.gains(predictor), limits, predictor.dt)
        feedforward = InverseControllerSettings(estimator=estimator).feedforward(predictor, inverse, limits)
        feedback = InversePid(feedforward, pid, predictor, limits), PidFeedback(pid, limits)
        return HandoverLaw(mpc, *feedback, (self.inverse_pid_above, self.pid_above))


@dataclass(frozen=True, eq=False)
class HandoverMemory:
    """The level that acts, and the memory of its law."""

    level: Level
    inner: Any


@final
class HandoverLaw(Law[HandoverMemory]):
    """One of three laws acts. It changes where the forecasts get better or worse; the command has no jump then.

    A level is left for a worse one as soon as the forecasts are worse than its threshold, and taken again once they are
    twice as good as that.
    """

    source = Source.MPC

    def __init__(
        self, mpc: Law[Any], inverse_pid: InversePid, pid: PidFeedback, thresholds: tuple[float, float]
    ) -> None:
        self.horizon = max(mpc.horizon, inverse_pid.horizon, pid.horizon)
        self._mpc, self._inverse_pid, self._pid = mpc, inverse_pid, pid
        self._laws: dict[Level, Law[Any]] = {"mpc": mpc, "inverse_pid": inverse_pid, "pid": pid}
        self._thresholds = thresholds

    def init(self, y: float, u: float) -> HandoverMemory:
        return HandoverMemory("mpc", self._mpc.init(y, u))

    def propose(self, memory: HandoverMemory, given: ControlInput, watch: Stopwatch) -> Proposal[HandoverMemory]:
        level = self._level(memory.level, given.distrust)
        if level != memory.level:
            memory = HandoverMemory(level, self._taken_over(level, given))
        law = self._laws[level]
        found = law.propose(memory.inner, replace(given, reference=given.reference[: law.horizon]), watch)
        status = found.status
        if level != "mpc":
            note = f"{level}: forecasts are off by {100 * given.distrust:.0f} % of the motion"
            status = note if status == "ok" else f"{note}; {status}"
        return Proposal(found.u, HandoverMemory(level, found.memory), found.plan, found.predicted, status, law.source)

    def _level(self, now: Level, distrust: float) -> Level:
        """The level at this distrust; better ones than the present only where it is clearly lower."""
        at = LEVELS.index(now)
        worst = sum(distrust > threshold for threshold in self._thresholds)
        best = sum(distrust > _BACK * threshold for threshold in self._thresholds)
        return LEVELS[max(worst, min(at, best))]

    def _taken_over(self, level: Level, given: ControlInput) -> Any:
        if level == "mpc":
            return self._mpc.init(given.measured, given.u_last)
        return self._inverse_pid.taken_over(given) if level == "inverse_pid" else self._pid.taken_over(given)
