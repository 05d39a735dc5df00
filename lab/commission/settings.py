"""Settings, jobs and results of the commissioning study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ..study import Figure, Result, StudySettings

Stage = Literal["commission", "compare", "gap"]
STAGES: tuple[Stage, ...] = ("commission", "compare", "gap")


class CommissionStudySettings(StudySettings):
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

    QUICK: ClassVar[Mapping[str, Any]] = {"devices": 8, "evaluations": 12, "diagnose": False}
    study: Literal["commission"] = "commission"
    devices: Annotated[int, Field(ge=1, le=1000)] = 60
    rates_hz: tuple[float, ...] = ()
    evaluations: Annotated[int, Field(ge=10)] = 300
    minutes: Annotated[float, Field(gt=0, le=5)] = 4.6
    diagnose: bool = True
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False


@dataclass(frozen=True)
class CommissionJob:
    """One device of the draw in one stage."""

    number: int
    stage: Stage
    key: str


@dataclass(frozen=True)
class CommissionResult(Result):
    """Outcome of one job.

    Attributes:
        message: the error of a failed job, else the verdict of the commissioning.
        facts: of the device, for tables.
        figures: by controller and figure such as `commissioned.rmse_deg`, see `scores`.
    """

    job: CommissionJob
    facts: Mapping[str, str | float] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
