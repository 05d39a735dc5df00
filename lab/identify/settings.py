"""Settings, jobs and results of the identification study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hystmpc.models.kinds.catalogue import chosen_kind

from ..study import Figure, Result, StudySettings

Interval = tuple[Figure, Figure, Figure]


class IdentifySettings(StudySettings):
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

    QUICK: ClassVar[Mapping[str, Any]] = {"devices": 4, "evaluations": 12}
    study: Literal["identify"] = "identify"
    devices: Annotated[int, Field(ge=1, le=1000)] = 60
    kind: str = "auto"
    drive: str | None = None
    rates_hz: tuple[float, ...] = ()
    evaluations: Annotated[int, Field(ge=10)] = 300
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    def check_names(self) -> None:
        chosen_kind(self.kind, self.drive)


@dataclass(frozen=True)
class IdentifyJob:
    """One device of the draw."""

    number: int
    key: str


@dataclass(frozen=True)
class IdentifyResult(Result):
    """Outcome of one device.

    Attributes:
        truth: what was drawn, 0 for what is not there: lag [s], delay [s], creep [1].
        found: value and 90 % interval of what was identified, by the same names; what is not among them is not there.
        facts: of the device: family, rate, noise and further numbers, for tables.
        figures: see `scores.scores`, by controller and figure such as `linearised.rmse_deg`; seconds by stage.
    """

    job: IdentifyJob
    truth: Mapping[str, float] = field(default_factory=dict)
    found: Mapping[str, Interval] = field(default_factory=dict)
    facts: Mapping[str, str | float] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
