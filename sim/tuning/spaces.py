"""Where settings are searched, and which plants are drawn, unless a configuration says otherwise."""

from __future__ import annotations

from hystmpc.ctrl.config import AnyControllerSettings

from ..config import PlantSettings
from ..plants import varied_parameters
from ..sweep.draws import DrawSettings

_ESTIMATOR = {
    "estimator.sensor_sigma_deg": DrawSettings(log_uniform=(0.03, 1.0)),
    "estimator.drift_sigma_deg_per_sqrt_s": DrawSettings(log_uniform=(0.03, 5.0)),
    "estimator.motion_sigma_deg_per_sqrt_unit": DrawSettings(uniform=(0.0, 6.0)),
    "estimator.dead_band_gain_deg_per_unit": DrawSettings(uniform=(0.0, 2.0)),
}
_GAINS = {
    "gains.kp_per_deg": DrawSettings(log_uniform=(1e-4, 0.2)),
    "gains.ki_per_deg_s": DrawSettings(log_uniform=(1e-2, 3.0)),
    "gains.kd_s_per_deg": DrawSettings(uniform=(0.0, 0.01)),
    "gains.dead_zone_deg": DrawSettings(uniform=(0.0, 0.5)),
}
_WEIGHTS = {
    "weights.rate": DrawSettings(log_uniform=(0.05, 100.0)),
    "weights.terminal": DrawSettings(log_uniform=(0.1, 20.0)),
    "weights.effort": DrawSettings(log_uniform=(1e-4, 0.3)),
}
_HORIZON = {"horizon": DrawSettings(integer=(5, 30))}
_SAMPLING = {
    "sigma": DrawSettings(log_uniform=(0.03, 1.5)),
    "temperature": DrawSettings(log_uniform=(2e-3, 0.5)),
}
# By kind of controller. Samples, iterations and solvers are left alone: they trade error for time, not for effort.
SPACES: dict[str, dict[str, DrawSettings]] = {
    "inverse": {**_ESTIMATOR, "reference_dead_zone_deg": DrawSettings(uniform=(0.0, 0.3))},
    "pid": _GAINS,
    "inverse_pid": {**_GAINS, "reference_dead_zone_deg": DrawSettings(uniform=(0.0, 0.3))},
    "linearised_mpc": {**_WEIGHTS, **_HORIZON, **_ESTIMATOR},
    "sampling_mpc": {**_WEIGHTS, **_HORIZON, **_ESTIMATOR, **_SAMPLING},
}

_LAG_S = (0.0, 0.15)
_NOISE_DEG = (0.05, 0.3)
_FACTOR = (0.9, 1.1)


def default_space(settings: AnyControllerSettings) -> dict[str, DrawSettings]:
    """Ranges by dotted path below a controller."""
    return dict(SPACES[settings.kind])


def default_draws(plant: PlantSettings) -> dict[str, DrawSettings]:
    """Lag, noise, and each parameter that varies within a tenth.

    Raises:
        ModelError: if the plant's file is missing or unusable.
    """
    draws = {"plant.lag_s": DrawSettings(uniform=_LAG_S), "plant.noise_deg": DrawSettings(uniform=_NOISE_DEG)}
    factor = DrawSettings(uniform=_FACTOR)
    return draws | {f'plant.mismatch."{label}"': factor for label in varied_parameters(plant)}
