"""Settings of the commissioning study."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.trials.config import Settings

_QUICK: dict[str, Any] = {"devices": 8, "evaluations": 12, "diagnose": False}


class CommissionStudySettings(Settings):
    """Settings of the study `commission`.

    Attributes:
        study: always `commission`.
        devices: how many are drawn.
        rates_hz: of the drawn devices, those of these sample rates are done [Hz]; all where it is empty.
        evaluations: closed-loop runs over all motions in the search of each rival's gains, about.
        minutes: device time of each commissioning [min]; a computed device is prepared anew before every motion, which
            takes some seconds more.
        diagnose: whether a commissioning diagnoses its model; takes most of the time, and changes no controller.
        seed: of the draw, the motions, the noise and the searches.
        quick: few and short motions at 25 Hz: proves that everything runs, and nothing else.
    """

    study: Literal["commission"] = "commission"
    devices: Annotated[int, Field(ge=1, le=1000)] = 60
    rates_hz: tuple[float, ...] = ()
    evaluations: Annotated[int, Field(ge=10)] = 300
    minutes: Annotated[float, Field(gt=0, le=5)] = 4.6
    diagnose: bool = True
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """The study with some changes; a change that is None keeps the default.

        Raises:
            ConfigError: on a number out of bounds.
        """
        data = dict(_QUICK) if changes.get("quick") else {}
        data |= {name: value for name, value in changes.items() if value is not None}
        return cls.parse(data, "study commission")
