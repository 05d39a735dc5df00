"""Settings of the closed-loop benchmark, and its motions."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

from .controllers import CONTROLLERS
from .plants import PLANTS

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
_QUICK: dict[str, Any] = {
    "rates_hz": (25.0,),
    "plants": ("backlash", "noisy-off"),
    "motions": ("point_to_point", "scan_0p5hz"),
    "network_updates": 40,
    "tune_evaluations": 12,
    "retune_evaluations": 12,
}


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


class ControlSettings(Settings):
    """Settings of the study `control`.

    Attributes:
        study: always `control`.
        rates_hz: sample rates of the loop [Hz].
        plants: by name, see `plants.PLANTS`.
        controllers: by name, see `controllers.CONTROLLERS`.
        motions: by name, see `MOTIONS`.
        tune_evaluations: runs over all motions that the search of a PID's gains takes at the first rate.
        retune_evaluations: the same at every further rate, where it starts from the gains found before.
        seed: of noise, search, random motion and training.
        quick: few and short motions, hardly trained networks: proves that everything runs, and nothing else.
    """

    study: Literal["control"] = "control"
    rates_hz: Annotated[tuple[Rate, ...], Field(min_length=1)] = RATES_HZ
    plants: tuple[str, ...] = tuple(PLANTS)
    controllers: tuple[str, ...] = tuple(CONTROLLERS)
    motions: tuple[str, ...] = MOTIONS
    network_updates: Annotated[int, Field(ge=1)] = 3000
    tune_evaluations: Annotated[int, Field(ge=10)] = 300
    retune_evaluations: Annotated[int, Field(ge=10)] = 48
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """The benchmark with some changes; a change that is None or empty keeps the default.

        Raises:
            ConfigError: on an unknown plant, controller or motion, or a rate out of bounds.
        """
        data = dict(_QUICK) if changes.get("quick") else {}
        data |= {name: value for name, value in changes.items() if value not in (None, (), [])}
        settings = cls.parse({name: _once(value) for name, value in data.items()}, "study control")
        for what, asked, known in (
            ("plant", settings.plants, PLANTS),
            ("controller", settings.controllers, CONTROLLERS),
            ("motion", settings.motions, MOTIONS),
        ):
            for name in asked:
                if name not in known:
                    raise ConfigError(f"study control: no {what} {name!r}, {did_you_mean(name, known)}")
        return settings


def _once(value: Any) -> Any:
    """Lists without what stands in them twice."""
    return tuple(dict.fromkeys(value)) if isinstance(value, list | tuple) else value
