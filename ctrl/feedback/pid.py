"""PID feedback on the tip angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, final

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ControllerError

from ..command import ControlInput, Source, Stopwatch
from ..estimation.observer import Observer, WithoutModel
from ..law import Law, LawSettings, Proposal
from ..limits import CommandLimits, NotNegative, Positive


class PidSettings(Settings):
    """Gains in the parallel form; command unit per degree.

    Attributes:
        kp_per_deg: proportional gain [mm/deg].
        ki_per_deg_s: integral gain [mm/(deg s)].
        kd_s_per_deg: derivative gain [mm s/deg], acting on the measurement.
        filter_s: time constant of the derivative's first-order filter [s].
        tracking_s: back-calculation time of the anti-windup [s].
        dead_zone_deg: errors below this are not integrated: inside the dead band of a play that hunts.
    """

    kp_per_deg: NotNegative = 0.02
    ki_per_deg_s: NotNegative = 0.3
    kd_s_per_deg: NotNegative = 0.0
    filter_s: NotNegative = 0.1
    tracking_s: Positive = 0.1
    dead_zone_deg: NotNegative = 0.2


@dataclass(frozen=True)
class PidMemory:
    """Integral part [command unit], filtered angular speed [deg/s], last angle [deg]."""

    integral: float
    speed: float
    angle: float


@final
class Pid:
    """u = kp e + I - kd dy/dt with I' = ki e + (u_limited - u) / tracking_s.

    One dead zone, one filter, one anti-windup; stateless, so that `PidFeedback` and `InversePid` share it.

    Raises:
        ControllerError: if `tracking_s` is shorter than the sample time.
    """

    def __init__(self, gains: PidSettings, limits: CommandLimits, dt: float) -> None:
        if gains.tracking_s < dt:
            raise ControllerError(f"pid: got tracking_s {gains.tracking_s}, expected at least the sample time {dt} s")
        self._gains, self._limits, self._dt = gains, limits, dt
        self._filter = dt / (gains.filter_s + dt)
        self._span = limits.upper - limits.lower

    def correct(
        self, memory: PidMemory, error: float, y: float, u_last: float, feedforward: float
    ) -> tuple[float, PidMemory]:
        """Command and next memory.

        Args:
            error: wanted minus measured angle [deg].
            u_last: the command really sent last.
            feedforward: added to the feedback.
        """
        gains = self._gains
        speed = memory.speed + self._filter * ((y - memory.angle) / self._dt - memory.speed)
        u = feedforward + gains.kp_per_deg * error + memory.integral - gains.kd_s_per_deg * speed
        excess = self._limits.clip(u, u_last, self._dt) - u
        integrated = error if abs(error) > gains.dead_zone_deg else 0.0
        integral = memory.integral + self._dt * (gains.ki_per_deg_s * integrated + excess / gains.tracking_s)
        return u, PidMemory(min(max(integral, -self._span), self._span), speed, y)

    def taken_over(self, error: float, y: float, u_last: float, feedforward: float) -> PidMemory:
        """The memory with which the next command is `u_last`."""
        return PidMemory(u_last - feedforward - self._gains.kp_per_deg * error, 0.0, y)


@final
class PidFeedback(Law[PidMemory]):
    """PID on the measured angle alone; starts without a bump from the command that the device holds."""

    horizon = 1
    source = Source.CONTROLLER

    def __init__(self, pid: Pid, limits: CommandLimits) -> None:
        self._pid = pid
        self._rest = limits.lower

    def init(self, y: float, u: float) -> PidMemory:
        return PidMemory(u - self._rest, 0.0, y)

    def taken_over(self, given: ControlInput) -> PidMemory:
        """The memory with which it takes over from another law without a jump of the command."""
        y = given.measured
        return self._pid.taken_over(given.setpoint - y, y, given.u_last, self._rest)

    def propose(self, memory: PidMemory, given: ControlInput, watch: Stopwatch) -> Proposal[PidMemory]:
        y = given.measured
        u, memory = self._pid.correct(memory, given.setpoint - y, y, given.u_last, self._rest)
        watch.lap("pid")
        return Proposal(u, memory)


class PidControllerSettings(LawSettings):
    """PID feedback, without a model."""

    falls_back_on_inverse: ClassVar[bool] = False

    kind: Literal["pid"] = "pid"
    gains: PidSettings = PidSettings()

    def observer(self, predictor: Predictor) -> Observer:
        del predictor
        return WithoutModel()

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[PidMemory]:
        del inverse
        return PidFeedback(Pid(self.gains, limits, predictor.dt), limits)
