"""Settings of every controller, told apart by `kind`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


class LimitsSettings(Settings):
    """Hard limits of the command [mm or bar] and of its rate [mm/s or bar/s]."""

    lower: float
    upper: float
    rate_per_s: Positive

    @model_validator(mode="after")
    def _ordered(self) -> LimitsSettings:
        if not self.lower < self.upper:
            raise ValueError(f"got lower {self.lower} and upper {self.upper}, expected lower < upper")
        return self


class ModelledLimitsSettings(LimitsSettings):
    """Hard limits where a model is known: those of the model may be narrowed, and exceeded only where it is said.

    Attributes:
        beyond_model: whether the limits may be wider than the command limits and rate that the model was made for; its
            predictions there are extrapolated, and the device may not be made for them either.
    """

    beyond_model: Annotated[bool, Field(strict=True)] = False


class EstimatorSettings(Settings):
    """See `EstimatorOptions`; the delay is what the model itself does not contain."""

    sensor_sigma_deg: Positive = 0.15
    drift_sigma_deg_per_sqrt_s: Positive = 0.4
    motion_sigma_deg_per_sqrt_unit: NotNegative = 0.0
    delay_samples: Annotated[int, Field(ge=0)] = 0
    outlier_deg: Positive = 15.0
    dead_band_gain_deg_per_unit: NotNegative = 1.0
    disturbance_limit_deg: Positive = 30.0


class AdaptationSettings(Settings):
    """What is learned on top of the model; see `LearnedOptions` and `LearningOptions`.

    `widest_share` is of the command's range, `share_sigma` and `slope_sigma` are shares of the model's mean slope.
    """

    plays: Annotated[int, Field(ge=0, le=20)] = 6
    widest_share: Annotated[float, Field(gt=0, le=1)] = 0.2
    lag_s: NotNegative = 0.0
    share_sigma: NotNegative = 0.25
    slope_sigma: NotNegative = 0.2
    rate_sigma_s: NotNegative = 0.05
    walk_share: NotNegative = 0.05


class HoldSettings(Settings):
    """When a command is held, and how gently it is corrected; see `HoldRule`, which counts samples."""

    tolerance_deg: NotNegative = 0.03
    patience_s: NotNegative = 0.4
    lead_s: NotNegative = 0.0
    settle_after_s: NotNegative = 0.4
    settle_s: NotNegative = 0.12


class LadderSettings(Settings):
    """When prediction, fallback and stop set in; see `LadderOptions` and `GuardedController`."""

    stop_after_failures: Count = 25
    max_missing_samples: Annotated[int, Field(ge=0)] = 25
    safe_command: float | None = None


class WeightsSettings(Settings):
    """See `Weights`: tracking per deg^2, the others per squared command unit; no angle limit where null."""

    tracking: Positive = 1.0
    terminal: NotNegative = 2.0
    rate: Positive = 3.0
    effort: NotNegative = 0.01
    soft_limit: NotNegative = 100.0
    angle_lower_deg: float | None = None
    angle_upper_deg: float | None = None


class PidSettings(Settings):
    """See `PidGains`; gains per degree in the parallel form."""

    kp_per_deg: NotNegative = 0.02
    ki_per_deg_s: NotNegative = 0.3
    kd_s_per_deg: NotNegative = 0.0
    filter_s: NotNegative = 0.1
    tracking_s: Positive = 0.1
    dead_zone_deg: NotNegative = 0.2


class _Common(Settings):
    """What every controller has. `limits` may only narrow those of the device; null takes them as they are."""

    limits: LimitsSettings | None = None
    ladder: LadderSettings = LadderSettings()


class InverseControllerSettings(_Common):
    """Inverse feedforward."""

    kind: Literal["inverse"] = "inverse"
    estimator: EstimatorSettings = EstimatorSettings()
    reference_dead_zone_deg: NotNegative = 0.027


class PidControllerSettings(_Common):
    """PID feedback, without a model."""

    kind: Literal["pid"] = "pid"
    gains: PidSettings = PidSettings()


class InversePidControllerSettings(_Common):
    """Inverse feedforward with PID feedback."""

    kind: Literal["inverse_pid"] = "inverse_pid"
    estimator: EstimatorSettings = EstimatorSettings()
    reference_dead_zone_deg: NotNegative = 0.027
    gains: PidSettings = PidSettings(kp_per_deg=0.01, ki_per_deg_s=0.2)


class _Predictive(_Common):
    """What both predictive controllers have."""

    estimator: EstimatorSettings = EstimatorSettings()
    adaptation: AdaptationSettings | None = None
    horizon: Count = 20
    weights: WeightsSettings = WeightsSettings()
    hold: HoldSettings = HoldSettings()


class LinearisedMpcSettings(_Predictive):
    """Real-time iteration; `solver_eps` is the tolerance of OSQP, DAQP is exact.

    `move_blocking` counts the samples of each block of moves, see `MoveBlocking`; null lets every sample move.
    """

    kind: Literal["linearised_mpc"] = "linearised_mpc"
    iterations: Count = 1
    solver: Literal["daqp", "osqp"] = "daqp"
    solver_eps: Annotated[float, Field(gt=0, le=1e-4)] = 1e-5
    move_blocking: Annotated[tuple[Count, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _blocks_fit(self) -> LinearisedMpcSettings:
        together = sum(self.move_blocking or ())
        if together > self.horizon:
            raise ValueError(
                f"got move_blocking of {together} samples together, expected at most the horizon of {self.horizon}"
            )
        return self


class SplineNoiseSettings(Settings):
    """Cubic spline through independent normals."""

    kind: Literal["spline"] = "spline"
    knots: Annotated[int, Field(ge=2)] = 6


class ColouredNoiseSettings(Settings):
    """Power spectrum 1 / f^exponent."""

    kind: Literal["coloured"] = "coloured"
    exponent: NotNegative = 2.0


class SamplingMpcSettings(_Predictive):
    """MPPI or CEM; see `SamplingOptions` and `CrossEntropyOptions`.

    `temperature` is MPPI's alone, `elites` is CEM's.
    """

    kind: Literal["sampling_mpc"] = "sampling_mpc"
    method: Literal["mppi", "cem"] = "mppi"
    samples: Count = 256
    iterations: Count = 2
    sigma: Positive = 0.3
    finest: Annotated[float, Field(gt=0, le=1)] = 0.01
    temperature: Positive = 0.02
    elites: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    seed: Annotated[int, Field(ge=0)] = 0
    noise: Annotated[SplineNoiseSettings | ColouredNoiseSettings, Field(discriminator="kind")] = SplineNoiseSettings()


AnyControllerSettings = (
    InverseControllerSettings
    | PidControllerSettings
    | InversePidControllerSettings
    | LinearisedMpcSettings
    | SamplingMpcSettings
)
ControllerSettings = Annotated[AnyControllerSettings, Field(discriminator="kind")]

# The one list of controllers: tests, studies and the command line read it.
CONTROLLERS: dict[str, type[AnyControllerSettings]] = {
    "inverse": InverseControllerSettings,
    "pid": PidControllerSettings,
    "inverse_pid": InversePidControllerSettings,
    "linearised_mpc": LinearisedMpcSettings,
    "sampling_mpc": SamplingMpcSettings,
}


def parse_controller(data: Any, where: str = "<memory>") -> AnyControllerSettings:
    """Validate a mapping with the key `kind`.

    Raises:
        ConfigError: if it is no mapping, `kind` is missing or unknown, or a setting of that kind is wrong.
    """
    if not isinstance(data, dict) or "kind" not in data:
        raise ConfigError(f"{where}: expected a mapping with the key 'kind', {did_you_mean('', CONTROLLERS)}")
    kind = str(data["kind"])
    if kind not in CONTROLLERS:
        raise ConfigError(f"{where}: kind: got {kind!r}, {did_you_mean(kind, CONTROLLERS)}")
    return CONTROLLERS[kind].parse(data, where)
