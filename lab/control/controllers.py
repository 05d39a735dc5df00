"""The controllers of the closed-loop benchmark: which law, on which model, with which settings at which rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

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
    """One controller of the benchmark.

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
        """Whether the bars are for it."""
        return self.kind in ("linearised_mpc", "sampling_mpc")

    @property
    def tuned(self) -> bool:
        """Whether its gains are searched for on the very plant and motions."""
        return self.kind in ("pid", "inverse_pid")

    @property
    def learns(self) -> bool:
        """Whether it learns what its model leaves over, from the flexure before the run on."""
        return self.predictive and not self.oracle

    @property
    def oracle(self) -> bool:
        """Whether its model is the plant."""
        return self.model == "oracle"

    def usable_at(self, rate_hz: float) -> bool:
        """Whether its model holds at a rate."""
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
