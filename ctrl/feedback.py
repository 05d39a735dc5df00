"""Feedback laws with settings: PID, inverse feedforward (S2 is RA-L 2024, PMC11633443), both together, supervisor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol, TypeVar, final

import numpy as np
from pydantic import field_validator

from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.trials.config import Count, NotNegative, Positive, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import EMPTY, CommandLimits, CommandPlan, ControlInput, Source, Stopwatch, attempt, replace
from .estimation.observer import EstimatorSettings, SensorKindSettings
from .guarded import Law, LawSettings, Proposal

S = TypeVar("S", bound=SensorKindSettings)

_HALF = 0.5001  # of a step: an error of exactly half of it is not integrated, whatever rounding does


class PidSettings(Settings):
    """PID gains in the parallel form, in command units per degree.

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

    def with_dead_zone(self, step_deg: float) -> PidSettings:
        """Return the gains with a dead zone of at least half a step of the sensor's readings."""
        least = _HALF * step_deg
        return self if self.dead_zone_deg >= least else self.model_copy(update={"dead_zone_deg": least})


@dataclass(frozen=True)
class PidMemory:
    """PID state: integral part [command unit], filtered speed [deg/s], last angle [deg] and its age [samples]."""

    integral: float
    speed: float
    angle: float
    age: float = 0.0


@final
class Pid:
    """PID law u = kp e + I - kd dy/dt with I' = ki e + (u_limited - u) / tracking_s.

    It is stateless, so that `PidFeedback` and `InversePid` share it. The slope dy/dt is that between two measurements,
    over the time between them; in samples without a new one it stays.

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
        """Return command and next memory of one sample, for `error` = reference minus measured angle [deg]."""
        gains, y, u_last = self._gains, given.measured, given.u_last
        new, speed, age = is_new(memory, given), memory.speed, memory.age + 1.0
        if new:
            elapsed = self._dt * max(age - given.age, 1.0)
            speed += elapsed / (gains.filter_s + elapsed) * ((y - memory.angle) / elapsed - speed)
        u = feedforward + gains.kp_per_deg * error + memory.integral - gains.kd_s_per_deg * speed
        excess = self._limits.clip(u, u_last, self._dt) - u
        integrated = error if abs(error) > gains.dead_zone_deg else 0.0
        integral = memory.integral + self._dt * (gains.ki_per_deg_s * integrated + excess / gains.tracking_s)
        newest = (y, given.age) if new else (memory.angle, age)
        return u, PidMemory(min(max(integral, -self._span), self._span), speed, *newest)

    def bumpless_start(self, error: float, given: ControlInput, feedforward: float) -> PidMemory:
        """Return the memory for a bumpless transfer: the next command equals the last one sent."""
        integral = given.u_last - feedforward - self._gains.kp_per_deg * error
        return PidMemory(integral, 0.0, given.measured, given.age)


def is_new(memory: PidMemory, given: ControlInput) -> bool:
    """Whether the measurement is newer than the one in the memory."""
    return given.age < memory.age + 1.0


@final
class PidFeedback(Law[PidMemory]):
    """PID feedback of the measured angle, with a bumpless start from the held command."""

    horizon = 1
    source = Source.CONTROLLER

    def __init__(self, pid: Pid, limits: CommandLimits) -> None:
        self._pid = pid
        self._rest = limits.lower

    def init(self, y: float, u: float) -> PidMemory:
        return PidMemory(u - self._rest, 0.0, y)

    def bumpless_start(self, given: ControlInput) -> PidMemory:
        """Return the memory for a bumpless transfer from another law: the next command equals the last one sent."""
        return self._pid.bumpless_start(given.setpoint - given.measured, given, self._rest)

    def propose(self, memory: PidMemory, given: ControlInput, watch: Stopwatch) -> Proposal[PidMemory]:
        u, memory = self._pid.correct(memory, given.setpoint - given.measured, given, self._rest)
        watch.lap("pid")
        return Proposal(u, memory)


def needs_sensor(estimator: S) -> S:
    """Check that block `estimator` of a feedback controller names a sensor, and return it.

    Raises:
        ValueError: if it says that there is no sensor.
    """
    if estimator.sensor == "none":
        raise ValueError("got sensor none, expected continuous or intermittent: feedback wants one, inverse does not")
    return estimator


class PidControllerSettings(LawSettings):
    """PID feedback control without a model.

    Attributes:
        estimator: how the measurements come; between the frames of an intermittent sensor the one taken last counts.
        gains: of the PID.
    """

    falls_back_on_inverse: ClassVar[bool] = False

    kind: Literal["pid"] = "pid"
    gains: PidSettings = PidSettings()
    estimator: SensorKindSettings = SensorKindSettings()

    _measures = field_validator("estimator")(needs_sensor)


REFERENCE_DEAD_ZONE_DEG = 0.027  # 0.0003 of 90 deg, RA-L 2024, PMC11633443 (S2)


@dataclass(frozen=True, eq=False)
class FeedforwardMemory:
    """Present reference angle [deg] and the remaining commands of the last plan (0..H,)."""

    followed: float
    plan: Vec = field(default_factory=lambda: EMPTY)


class AheadOfTime(Protocol):
    """Inverse over a preview, such as `FeasibleInverse`."""

    horizon: int

    def plan(self, state: Vec, u_last: float, wanted: Vec, remaining: Vec, tolerance_deg: float) -> CommandPlan:
        """Plan commands along reference angles (H,) [deg]; see `FeasibleInverse.plan`."""
        ...


@final
class InverseFeedforward(Law[FeedforwardMemory]):
    """Inverse feedforward u = inverse(x, theta_ref), without feedback; x follows from the commands really sent.

    A reference that changes by less than the dead zone is not followed: any noise on it would flip the branch of
    the inverse and jump across the whole dead band (RA-L 2024, PMC11633443 (S2), inverse backlash).

    Args:
        ahead: plans over a preview, for a model with lag or delay; None for the inverse sample by sample.
    """

    source = Source.CONTROLLER

    def __init__(
        self,
        inverse: Inverse,
        dead_zone_deg: float = REFERENCE_DEAD_ZONE_DEG,
        ahead: AheadOfTime | None = None,
    ) -> None:
        self._inverse, self._dead_zone, self._ahead = inverse, dead_zone_deg, ahead
        self.horizon = 1 if ahead is None else ahead.horizon

    def init(self, y: float, u: float) -> FeedforwardMemory:
        del u
        return FeedforwardMemory(y)

    def propose(self, memory: FeedforwardMemory, given: ControlInput, watch: Stopwatch) -> Proposal[FeedforwardMemory]:
        wanted = np.array(given.reference[: self.horizon])
        before = memory.followed
        for k, angle in enumerate(wanted.tolist()):
            before = wanted[k] = angle if abs(angle - before) >= self._dead_zone else before
        followed = float(wanted[0])
        if self._ahead is None:
            u = self._inverse.command(given.state, followed, given.u_last)
            watch.lap("inverse")
            return Proposal(u, FeedforwardMemory(followed))
        plan = self._ahead.plan(given.state, given.u_last, wanted, memory.plan, self._dead_zone)
        watch.lap("inverse")
        return Proposal(
            float(plan.commands[0]), FeedforwardMemory(followed, plan.commands[1:]), plan.commands, plan.angles
        )


@dataclass(frozen=True, eq=False)
class InversePidMemory:
    """State of `InversePid`: its memories, the due angles, newest last, and the model state under feedforward alone."""

    feedforward: FeedforwardMemory
    pid: PidMemory
    state: Vec
    u: float
    dues: tuple[float, ...] = ()
    error: float = 0.0


@final
class InversePid(Law[InversePidMemory]):
    """Inverse feedforward with PID feedback: u = inverse(x_ff, theta_ref) + PID(theta_due - y).

    The feedback compares the measurement with the angle that was due when it was taken, so that its error is zero under
    a perfect feedforward; without a new measurement the error stays. The inverse remembers its own commands x_ff, not
    the sum: otherwise it would cross the dead band to undo every correction.

    Args:
        oldest: age of the oldest measurement [samples].
    """

    source = Source.CONTROLLER

    def __init__(
        self, feedforward: InverseFeedforward, pid: Pid, predictor: Predictor, limits: CommandLimits, oldest: int = 0
    ) -> None:
        self.horizon = feedforward.horizon
        self._feedforward, self._pid, self._kept = feedforward, pid, oldest + 1
        self._predictor, self._limits = predictor, limits

    def init(self, y: float, u: float) -> InversePidMemory:
        state = self._predictor.initial(y, u)
        return InversePidMemory(self._feedforward.init(y, u), PidMemory(0.0, 0.0, y), state, u)

    def bumpless_start(self, given: ControlInput) -> InversePidMemory:
        """Return the memory for a bumpless transfer from another law: the next command equals the last one sent."""
        before = self._feedforward.init(given.due, given.u_last)
        alone = self._feedforward.propose(before, given, Stopwatch())
        u_alone = self._limits.clip(alone.u, given.u_last, self._predictor.dt)
        pid = self._pid.bumpless_start(given.due - given.measured, given, u_alone)
        return InversePidMemory(before, pid, given.state, given.u_last)

    def propose(self, memory: InversePidMemory, given: ControlInput, watch: Stopwatch) -> Proposal[InversePidMemory]:
        alone = replace(given, state=memory.state, u_last=memory.u)
        wanted = self._feedforward.propose(memory.feedforward, alone, watch)
        u_alone = self._limits.clip(wanted.u, memory.u, self._predictor.dt)
        _, state = self._predictor.advance(memory.state, u_alone)
        watch.lap("inverse")
        dues, error = (*memory.dues, given.due)[-self._kept :], memory.error
        if is_new(memory.pid, given):
            error = dues[-1 - min(round(given.age), len(dues) - 1)] - given.measured
        u, pid = self._pid.correct(memory.pid, error, given, u_alone)
        watch.lap("pid")
        return Proposal(u, InversePidMemory(wanted.memory, pid, state, u_alone, dues, error))


class FeedforwardSettings(LawSettings):
    """Common settings of both controllers with an inverse.

    Attributes:
        reference_dead_zone_deg: change of the reference that is not followed [deg].
        preview: samples of the reference that the inverse of a model with lag or delay looks at.
        estimator: how state and disturbance are estimated from the measurements.
    """

    estimator: EstimatorSettings = EstimatorSettings()  # pyright: ignore[reportIncompatibleVariableOverride]  # frozen
    reference_dead_zone_deg: NotNegative = REFERENCE_DEAD_ZONE_DEG
    preview: Count = 20


class InverseControllerSettings(FeedforwardSettings):
    """Inverse feedforward without feedback."""

    kind: Literal["inverse"] = "inverse"


class InversePidControllerSettings(FeedforwardSettings):
    """Inverse feedforward with PID feedback.

    Attributes:
        gains: of the PID.
    """

    kind: Literal["inverse_pid"] = "inverse_pid"
    gains: PidSettings = PidSettings(kp_per_deg=0.01, ki_per_deg_s=0.2)

    _measures = field_validator("estimator")(needs_sensor)


class SupervisorSettings(Settings):
    """Block `supervisor`: selection of the control law by the error of the forecasts of the last seconds.

    The error of a forecast over 0.24 s is compared with that of a constant angle (root mean squares, see `FilterBank`).

    Attributes:
        inverse_pid_above: relative error from which on inverse and PID take over from the predictive controller.
        pid_above: relative error from which on the PID alone takes over.
        pid: gains of both; null for 0.2 / G and 1.5 / (G s), where G is the model's static gain [deg per command unit].
    """

    inverse_pid_above: Positive = 0.95
    pid_above: Positive = 1.05
    pid: PidSettings | None = None


SupervisorLevel = Literal["mpc", "inverse_pid", "pid"]
LEVELS: tuple[SupervisorLevel, ...] = ("mpc", "inverse_pid", "pid")

_BACK = 0.5  # share of a threshold below which a better level takes over again
_KP_SHARE, _KI_PER_S = 0.2, 1.5  # of gains that nobody has tuned, in units of the inverse of the model's static gain


def feedback_gains(settings: SupervisorSettings, predictor: Predictor) -> PidSettings:
    """Return the PID gains of both feedback laws for a model."""
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
    """Build the supervisory law: the predictive law and two feedback laws, all on one model.

    The inverse is that of the hysteresis alone: inverting lag and delay of a model that predicts badly gains nothing.
    """
    predictor, inverse = pair
    pid = Pid(feedback_gains(settings, predictor), limits, predictor.dt)
    feedback = InversePid(InverseFeedforward(inverse), pid, predictor, limits), PidFeedback(pid, limits)
    return SupervisoryLaw(mpc, *feedback, (settings.inverse_pid_above, settings.pid_above))


@dataclass(frozen=True, eq=False)
class SupervisorMemory:
    """Active level of the supervisor, and the memory of its law."""

    level: SupervisorLevel
    inner: Any


@final
class SupervisoryLaw(Law[SupervisorMemory]):
    """Supervisory control: the error of the forecasts selects one of three laws, with bumpless transfer.

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
        """Level for this error of the forecasts, with hysteresis before the return to a better one."""
        at = LEVELS.index(now)
        worst = sum(forecast_error > threshold for threshold in self._thresholds)
        best = sum(forecast_error > _BACK * threshold for threshold in self._thresholds)
        return LEVELS[max(worst, min(at, best))]

    def _bumpless_start(self, level: SupervisorLevel, given: ControlInput) -> Any:
        if level == "mpc":
            return self._mpc.init(given.measured, given.u_last)
        return self._inverse_pid.bumpless_start(given) if level == "inverse_pid" else self._pid.bumpless_start(given)
