"""Settings, controllers and motions of the closed-loop benchmark, its jobs and results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from hystmpc.trials.errors import ConfigError, did_you_mean

from ..study import Figure, Result, StudySettings
from .plants import PLANTS

ModelName = Literal["none", "backlash", "lstm", "hb2", "oracle"]
NETWORKS: tuple[ModelName, ...] = ("lstm", "hb2")
NETWORK_RATE_HZ = 25.0
"""A network holds at the sample time at which it was identified, and at 250 Hz trials are ten times as long."""

# Fixed, so that results stay comparable: what a model gets wrong shows while the command moves.
_ESTIMATOR = {
    "sensor_sigma_deg": 0.15,
    "drift_sigma_deg_per_sqrt_s": 0.3,
    "motion_sigma_deg_per_sqrt_unit": 1.5,
    "dead_band_gain_deg_per_unit": 0,
}
# An exact model needs no disturbance; this lets what is left of the first guess decay, and no noise in.
_TRUST = _ESTIMATOR | {"drift_sigma_deg_per_sqrt_s": 0.01, "motion_sigma_deg_per_sqrt_unit": 0.0}
_RATE_WEIGHT = 3.0  # at 25 Hz
_BASE_DT_S = 0.04
_FAST_DT_S = 0.01
ORACLE = "oracle"
BASELINES = ("pid", "inverse", "inverse_pid")


@dataclass(frozen=True)
class BenchmarkController:
    """Controller of the benchmark.

    Attributes:
        kind: of `ctrl.config.CONTROLLERS`.
        model: what it knows of the plant: `none`, a backlash, a network, or `oracle` for the plant itself.
        trusting: an oracle whose estimator knows that its model is exact.
    """

    name: str
    kind: str
    model: ModelName
    trusting: bool = False

    @property
    def predictive(self) -> bool:
        """Whether the bars apply to it."""
        return self.kind in ("linearised_mpc", "sampling_mpc")

    @property
    def tuned(self) -> bool:
        """Whether its gains are tuned on the same plant and motions."""
        return self.kind in ("pid", "inverse_pid")

    @property
    def learns(self) -> bool:
        """Whether it learns the error of its model, starting with the flexure before the run."""
        return self.predictive and not self.oracle

    @property
    def oracle(self) -> bool:
        """Whether its model is the plant."""
        return self.model == "oracle"

    def usable_at(self, rate_hz: float) -> bool:
        """Whether its model is valid at a rate."""
        return self.model not in NETWORKS or rate_hz == NETWORK_RATE_HZ

    def settings(self, dt_s: float, delay_samples: int) -> dict[str, Any]:
        """Settings of the controller, as in a simulation file.

        The weight of the command's rate is scaled so that the same motion costs the same share at any sample time:
        sum q e^2 + w (u_k - u_{k-1})^2 is the integral of q e^2 + w dt^2 u'^2 over dt.

        Args:
            dt_s: sample time [s].
        """
        if self.kind == "pid":
            return {"kind": self.kind}
        if not self.predictive:
            return {"kind": self.kind, "estimator": {"delay_samples": delay_samples}}
        fast = dt_s < _FAST_DT_S
        settings: dict[str, Any] = {
            "kind": self.kind,
            "horizon": 50 if fast else 20,
            "estimator": {**(_TRUST if self.trusting else _ESTIMATOR), "delay_samples": delay_samples},
            "weights": {"rate": _RATE_WEIGHT * (_BASE_DT_S / dt_s) ** 2},
        }
        if not self.learns:
            settings["adaptation"] = None
        return settings


def _named(*rivals: BenchmarkController) -> Mapping[str, BenchmarkController]:
    return MappingProxyType({rival.name: rival for rival in rivals})


CONTROLLERS: Mapping[str, BenchmarkController] = _named(
    BenchmarkController("pid", "pid", "none"),
    BenchmarkController("inverse", "inverse", "backlash"),
    BenchmarkController("inverse_pid", "inverse_pid", "backlash"),
    BenchmarkController("linearised_backlash", "linearised_mpc", "backlash"),
    BenchmarkController("linearised_lstm", "linearised_mpc", "lstm"),
    BenchmarkController("linearised_hb2", "linearised_mpc", "hb2"),
    BenchmarkController("sampling_backlash", "sampling_mpc", "backlash"),
    BenchmarkController("sampling_lstm", "sampling_mpc", "lstm"),
    BenchmarkController("sampling_hb2", "sampling_mpc", "hb2"),
    BenchmarkController(ORACLE, "linearised_mpc", "oracle"),
    BenchmarkController("oracle_trusting", "linearised_mpc", "oracle", trusting=True),
)
"""All controllers by name; `oracle` is `linearised_backlash` with the plant as its model and nothing to learn."""


POINT_TO_POINT = "point_to_point"
RANDOM = "random_ruckig"
SCANS_HZ = {"scan_0p1hz": 0.1, "scan_0p25hz": 0.25, "scan_0p5hz": 0.5}
MOTIONS = (POINT_TO_POINT, *SCANS_HZ, RANDOM)

# Between 46 and 78 deg, which every plant reaches.
_TARGETS_DEG = (60.0, 48.0, 75.0, 70.0, 62.0, 66.0)
_HOLD_S = 3.0  # its last half is longer than any controller's preview
_RANGE_DEG = (47.0, 77.0)
_MOVES = 6
_CENTRE_DEG, _AMPLITUDE_DEG = 62.0, 15.0
_SCAN_S = 12.0  # about; whole cycles, at least two
_LIMITS = {"velocity_deg_s": 30.0, "acceleration_deg_s2": 200.0, "jerk_deg_s3": 3000.0}
Rate = Annotated[float, Field(gt=0, le=1000)]
RATES_HZ = (25.0, 250.0)
Stage = Literal["fit", "tune", "retune", "run"]
STAGES: tuple[Stage, ...] = ("fit", "tune", "retune", "run")
"""In this order: every stage needs what the ones before it leave."""


def motion(name: str, rest_deg: float, seed: int, quick: bool = False) -> dict[str, Any]:
    """Settings of a motion, as in a simulation file.

    Args:
        name: one of `MOTIONS`.
        rest_deg: angle at which the plant rests at first [deg].

    Raises:
        ConfigError: on an unknown motion.
    """
    if name == POINT_TO_POINT:
        targets = _TARGETS_DEG[:2] if quick else _TARGETS_DEG
        holds = (_HOLD_S,) * len(targets)
        return {"kind": name, "start_deg": rest_deg, "targets_deg": targets, "holds_s": holds, "limits": _LIMITS}
    if name in SCANS_HZ:
        frequency = SCANS_HZ[name]
        return {
            "kind": "scan_sinusoid",
            "start_deg": rest_deg,
            "centre_deg": _CENTRE_DEG,
            "amplitude_deg": _AMPLITUDE_DEG,
            "frequency_hz": frequency,
            "cycles": 1.0 if quick else max(2.0, float(round(_SCAN_S * frequency))),
        }
    if name == RANDOM:
        return {
            "kind": "random_point_to_point",
            "seed": seed,
            "start_deg": rest_deg,
            "range_deg": _RANGE_DEG,
            "moves": 2 if quick else _MOVES,
            "hold_range_s": (1.0, 3.0),
            "limits": _LIMITS,
        }
    raise ConfigError(f"no motion {name!r}, {did_you_mean(name, MOTIONS)}")


class ControlSettings(StudySettings):
    """Settings of the study `control`.

    Attributes:
        rates_hz: sample rates of the loop [Hz].
        plants: by name, see `PLANTS`.
        controllers: by name, see `CONTROLLERS`.
        motions: by name, see `MOTIONS`.
        tune_evaluations: runs over all motions that the search of a PID's gains takes at the first rate.
        retune_evaluations: the same at every further rate, where it starts from the gains found before.
    """

    QUICK: ClassVar[Mapping[str, Any]] = {
        "rates_hz": (25.0,),
        "plants": ("backlash", "noisy-off"),
        "motions": ("point_to_point", "scan_0p5hz"),
        "network_updates": 40,
        "tune_evaluations": 12,
        "retune_evaluations": 12,
    }
    study: Literal["control"] = "control"
    rates_hz: Annotated[tuple[Rate, ...], Field(min_length=1)] = RATES_HZ
    plants: tuple[str, ...] = tuple(PLANTS)
    controllers: tuple[str, ...] = tuple(CONTROLLERS)
    motions: tuple[str, ...] = MOTIONS
    network_updates: Annotated[int, Field(ge=1)] = 3000
    tune_evaluations: Annotated[int, Field(ge=10)] = 300
    retune_evaluations: Annotated[int, Field(ge=10)] = 48

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """Benchmark with some changes and without repeated names; see `StudySettings.of`."""
        once = {k: tuple(dict.fromkeys(v)) if isinstance(v, list | tuple) else v for k, v in changes.items()}
        return super().of(**once)

    def check_names(self) -> None:
        for what, asked, known in (
            ("plant", self.plants, PLANTS),
            ("controller", self.controllers, CONTROLLERS),
            ("motion", self.motions, MOTIONS),
        ):
            for name in asked:
                if name not in known:
                    raise ConfigError(f"study control: no {what} {name!r}, {did_you_mean(name, known)}")


@dataclass(frozen=True)
class ControlJob:
    """Job of the benchmark.

    Attributes:
        stage: `fit` identifies a model, `tune` searches gains at the first rate, `retune` at another, `run` is a
            controller along a motion.
        plant: by name; of a `fit` the family.
        rate_hz: of the loop; 0 for a `fit`.
        subject: kind of model of a `fit`, else controller.
        motion: of a `run`, else empty.
    """

    stage: Stage
    plant: str
    rate_hz: float
    subject: str
    motion: str = ""

    @property
    def key(self) -> str:
        """Name of the job's files: unique in a study."""
        parts = [self.stage, self.plant, f"{self.rate_hz:g}hz" if self.rate_hz else "", self.subject, self.motion]
        return "-".join(part for part in parts if part)


@dataclass(frozen=True)
class ControlResult(Result):
    """Outcome of one job.

    Attributes:
        figures: of a run, see `control_figures`; of a search its error; NaN where there is none.
        ladder: of a run, samples by source of the command.
    """

    job: ControlJob
    figures: Mapping[str, Figure] = field(default_factory=dict)
    ladder: Mapping[str, int] = field(default_factory=dict)
