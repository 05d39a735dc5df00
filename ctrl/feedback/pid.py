"""PID feedback on the tip angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeVar, final

from pydantic import field_validator

from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.config import NotNegative, Positive, Settings
from hystmpc.trials.errors import ControllerError

from ..command import ControlInput, Source, Stopwatch
from ..estimation.observer import LastFrame, Observer, SensorKindSettings, WithoutModel
from ..law import Law, LawSettings, Proposal
from ..limits import CommandLimits

S = TypeVar("S", bound=SensorKindSettings)

_HALF = 0.5001  # of a step: an error of exactly half of it is not integrated, whatever rounding does


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

    def deaf_to(self, step_deg: float) -> PidSettings:
        """The same with errors within half a step of the sensor's readings not integrated: they may be its own."""
        least = _HALF * step_deg
        return self if self.dead_zone_deg >= least else self.model_copy(update={"dead_zone_deg": least})


@dataclass(frozen=True)
class PidMemory:
    """Integral part [command unit], filtered angular speed [deg/s], last angle [deg] and its age [samples]."""

    integral: float
    speed: float
    angle: float
    age: float = 0.0


@final
class Pid:
    """u = kp e + I - kd dy/dt with I' = ki e + (u_limited - u) / tracking_s.

    One dead zone, one filter, one anti-windup; stateless, so that `PidFeedback` and `InversePid` share it. The slope
    dy/dt is that between two measurements, over the time between them; in samples without a new one it stays.

    Raises:
        ControllerError: if `tracking_s` is shorter than the sample time.
    """

    def __init__(self, gains: PidSettings, limits: CommandLimits, dt: float) -> None:
        if gains.tracking_s < dt:
            raise ControllerError(f"pid: got tracking_s {gains.tracking_s}, expected at least the sample time {dt} s")
        self._gains, self._limits, self._dt = gains, limits, dt
        self._span = limits.upper - limits.lower

    def correct(
        self, memory: PidMemory, error: float, given: ControlInput, feedforward: float
    ) -> tuple[float, PidMemory]:
        """Command and next memory.

        Args:
            error: wanted minus measured angle [deg].
            given: measured angle, its age, and the command really sent last.
            feedforward: added to the feedback.
        """
        gains, y, u_last = self._gains, given.measured, given.u_last
        new, speed, age = is_new(memory, given), memory.speed, memory.age + 1.0
        if new:
            elapsed = self._dt * max(age - given.age, 1.0)
            speed += elapsed / (gains.filter_s + elapsed) * ((y - memory.angle) / elapsed - speed)
        u = feedforward + gains.kp_per_deg * error + memory.integral - gains.kd_s_per_deg * speed
        excess = self._limits.clip(u, u_last, self._dt) - u
        integrated = error if abs(error) > gains.dead_zone_deg else 0.0
        integral = memory.integral + self._dt * (gains.ki_per_deg_s * integrated + excess / gains.tracking_s)
        seen = (y, given.age) if new else (memory.angle, age)
        return u, PidMemory(min(max(integral, -self._span), self._span), speed, *seen)

    def taken_over(self, error: float, given: ControlInput, feedforward: float) -> PidMemory:
        """The memory with which the next command is the last one sent; arguments as of `correct`."""
        integral = given.u_last - feedforward - self._gains.kp_per_deg * error
        return PidMemory(integral, 0.0, given.measured, given.age)


def is_new(memory: PidMemory, given: ControlInput) -> bool:
    """Whether the measurement was taken after the one that the memory holds."""
    return given.age < memory.age + 1.0


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
        return self._pid.taken_over(given.setpoint - given.measured, given, self._rest)

    def propose(self, memory: PidMemory, given: ControlInput, watch: Stopwatch) -> Proposal[PidMemory]:
        u, memory = self._pid.correct(memory, given.setpoint - given.measured, given, self._rest)
        watch.lap("pid")
        return Proposal(u, memory)


def needs_sensor(estimator: S) -> S:
    """The block `estimator` of a controller with feedback.

    Raises:
        ValueError: if it says that there is no sensor.
    """
    if estimator.sensor == "none":
        raise ValueError("got sensor none, expected continuous or intermittent: feedback wants one, inverse does not")
    return estimator


class PidControllerSettings(LawSettings):
    """PID feedback, without a model.

    Attributes:
        estimator: how the measurements come; between the frames of an intermittent sensor the one taken last counts.
        gains: of the PID.
    """

    falls_back_on_inverse: ClassVar[bool] = False

    kind: Literal["pid"] = "pid"
    gains: PidSettings = PidSettings()
    estimator: SensorKindSettings = SensorKindSettings()

    _measures = field_validator("estimator")(needs_sensor)

    def bridged_samples(self, dt_s: float) -> int:
        return self.estimator.bridged_samples(self.ladder.max_missing_samples, dt_s)

    def observer(self, predictor: Predictor) -> Observer:
        if self.estimator.sensor == "continuous":
            return WithoutModel()
        return LastFrame(self.estimator.oldest_samples(predictor.dt))

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[PidMemory]:
        del inverse
        return PidFeedback(Pid(self.gains, limits, predictor.dt), limits)
