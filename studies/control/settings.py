"""Settings of the closed-loop benchmark: which plants, rates, controllers and motions."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

from .motions import MOTIONS
from .plants import PLANTS
from .rivals import CONTROLLERS

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


class ControlSettings(Settings):
    """What the study `control` needs to know.

    Attributes:
        study: always `control`.
        rates_hz: sample rates of the loop [Hz].
        plants: by name, see `control_plants.PLANTS`.
        controllers: by name, see `control_rivals.CONTROLLERS`.
        motions: by name, see `control_motions.MOTIONS`.
        network_updates: updates of every network's training.
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
