"""Settings of the feedback laws: PID, inverse feedforward (S2 is RA-L 2024, PMC11633443), both together, supervisor.

The engine computes them, see core/feedback.c.
"""

from __future__ import annotations

from typing import ClassVar, Literal, TypeVar

from pydantic import field_validator

from hystmpc.models.model import Predictor, static_gain
from hystmpc.trials.config import Count, NotNegative, Positive, Settings

from .command import attempt
from .estimation.observer import EstimatorSettings, SensorKindSettings
from .law import LawSettings

S = TypeVar("S", bound=SensorKindSettings)

_HALF = 0.5001  # of a step: an error of exactly half of it is not integrated, whatever rounding does


class PidSettings(Settings):
    """PID gains in the parallel form, u = kp e + I - kd dy/dt with I' = ki e + (u_limited - u) / tracking_s.

    The slope dy/dt is that between two measurements, over the time between them; without a new one it stays.

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
    """Inverse feedforward without feedback: u = inverse(x, theta_ref), x following from the commands really sent.

    A reference that changes by less than the dead zone is not followed: any noise on it would flip the branch of the
    inverse and jump across the whole dead band (RA-L 2024, PMC11633443 (S2), inverse backlash).
    """

    kind: Literal["inverse"] = "inverse"


class InversePidControllerSettings(FeedforwardSettings):
    """Inverse feedforward with PID feedback: u = inverse(x_ff, theta_ref) + PID(theta_due - y).

    The feedback compares the measurement with the angle that was due when it was taken. The inverse remembers its own
    commands x_ff, not the sum: otherwise it would cross the dead band to undo every correction.

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
