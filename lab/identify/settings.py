"""Settings of the identification study."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.models.kinds.catalogue import chosen_kind
from hystmpc.trials.config import Settings

_QUICK: dict[str, Any] = {"devices": 4, "evaluations": 12}


class IdentifySettings(Settings):
    """Settings of the study `identify`.

    Attributes:
        study: always `identify`.
        devices: how many are drawn.
        kind: of model that is identified, by name, see `hystmpc fit`.
        drive: of a kind without one of its own: `auto` identifies the drive, see `hystmpc fit --drive`.
        rates_hz: of the drawn devices, those of these sample rates are done [Hz]; all where it is empty.
        evaluations: closed-loop runs over all motions in the search of each PID's gains, about.
        seed: of the draw, the motions, the noise and the searches.
        quick: few motions and short ones at 25 Hz: proves that everything runs, and nothing else.
    """

    study: Literal["identify"] = "identify"
    devices: Annotated[int, Field(ge=1, le=1000)] = 60
    kind: str = "auto"
    drive: str | None = None
    rates_hz: tuple[float, ...] = ()
    evaluations: Annotated[int, Field(ge=10)] = 300
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """The study with some changes; a change that is None keeps the default.

        Raises:
            ConfigError: on a number out of bounds.
            FitError: on an unknown kind of model.
        """
        data = dict(_QUICK) if changes.get("quick") else {}
        data |= {name: value for name, value in changes.items() if value is not None}
        settings = cls.parse(data, "study identify")
        chosen_kind(settings.kind, settings.drive)
        return settings
