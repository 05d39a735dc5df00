"""Handover: predictive control where the model foretells what is measured, feedback where it does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, final

from hystmpc.models.model import Inverse, Predictor, static_gain

from .command import CommandLimits, ControlInput, Source, Stopwatch, attempt, replace
from .feedback import InverseFeedforward, InversePid, Pid, PidFeedback, PidSettings
from .law import Law, Proposal
from .mpc_settings import HandoverSettings

Level = Literal["mpc", "inverse_pid", "pid"]
LEVELS: tuple[Level, ...] = ("mpc", "inverse_pid", "pid")

_BACK = 0.5  # share of a threshold below which a better level takes over again
_KP_SHARE, _KI_PER_S = 0.2, 1.5  # of gains that nobody has tuned, in units of the inverse of the model's static gain


def gains_for(settings: HandoverSettings, predictor: Predictor) -> PidSettings:
    """The gains of both feedback laws, for a model."""
    if settings.pid is not None:
        return settings.pid
    gain = attempt(lambda: static_gain(predictor))[0] or 0.0
    found = PidSettings()
    if gain > 0:
        found = PidSettings(kp_per_deg=_KP_SHARE / gain, ki_per_deg_s=_KI_PER_S / gain)
    return found if predictor.noise is None else found.deaf_to(predictor.noise.sensor_resolution_deg)


def handover_law(
    mpc: Law[Any],
    settings: HandoverSettings,
    pair: tuple[Predictor, Inverse],
    limits: CommandLimits,
) -> HandoverLaw:
    """The predictive law with the two that take over from it, on one model.

    The inverse is that of the hysteresis alone, sample by sample: of a model that foretells so badly, lag and delay are
    not worth undoing.
    """
    predictor, inverse = pair
    pid = Pid(gains_for(settings, predictor), limits, predictor.dt)
    feedback = InversePid(InverseFeedforward(inverse), pid, predictor, limits), PidFeedback(pid, limits)
    return HandoverLaw(mpc, *feedback, (settings.inverse_pid_above, settings.pid_above))


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
