"""Settings, results and requirements of the commissioning study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from hystmpc.gap.diagnosis import TrackingGap
from hystmpc.gap.expected_tracking import AGREEMENT

from ..devices.drawn import DrawnSettings
from ..page import Bar, Figures, beyond, by_device, over
from ..study import Figure, Outcome, Result

Stage = Literal["commission", "compare", "gap"]
STAGES: tuple[Stage, ...] = ("commission", "compare", "gap")
WORN = {"friction": (2.0, 1.0), "stiffness": (1.0, 2.0)}
"""Factors on friction and stiffness of a device that has changed since it was commissioned."""


class CommissionStudySettings(DrawnSettings):
    """Settings of the study `commission`.

    Attributes:
        minutes: device time of each commissioning [min]; a computed device is prepared anew before every motion, which
            takes some seconds more.
        diagnose: whether a commissioning diagnoses its model; takes most of the time, and changes no controller.
    """

    QUICK: ClassVar[Mapping[str, Any]] = {"devices": 8, "evaluations": 12, "diagnose": False}
    study: Literal["commission"] = "commission"
    minutes: Annotated[float, Field(gt=0, le=5)] = 4.6
    diagnose: bool = True


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
        figures: by controller and figure such as `commissioned.rmse_deg`, see `identify.job.scores`.
    """

    job: CommissionJob
    facts: Mapping[str, str | float] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)


RIVALS = ("pid", "inverse_pid")
MOST_DEVICE_S = 300.0


@dataclass(frozen=True, eq=False)
class CommissionOutcome(Outcome[CommissionStudySettings, CommissionResult]):
    """Study with the results of all its jobs."""

    @cached_property
    def figures(self) -> Mapping[str, Figures]:
        """All figures of a device, of both stages, by its name."""
        merged: dict[str, dict[str, float]] = {}
        for result in self.results:
            merged.setdefault(device_of(result), {}).update(result.figures)
        return merged

    @cached_property
    def families(self) -> Mapping[str, str]:
        """Family of each device."""
        return {device_of(result): str(result.facts["family"]) for result in self.results}


def device_of(result: CommissionResult) -> str:
    """Name of a job's device."""
    return result.job.key.removesuffix(f"-{result.job.stage}")


def over_rival(controller: str) -> Callable[[Figures], float]:
    """RMSE of a controller divided by that of the better tuned rival; infinite if one of them is missing."""
    return over(controller, *RIVALS)


def bars(outcome: CommissionOutcome) -> list[Bar]:
    """All bars of the study; a device with a failed job counts as infinitely bad."""
    learned = [(f"{name} changed, learning over none", over(name, f"{name}_off")) for name in WORN]
    return [
        *_quantiles(outcome, "commissioned, over the best tuned rival", over_rival("commissioned"), (0.5, 0.8, 1.1)),
        _worst(outcome, "device time of a commissioning [s]", lambda f: f.get("device_s", math.inf), MOST_DEVICE_S),
        _worst(outcome, "learning over none, as commissioned: worst", over("commissioned", "learning_off"), 1.05),
        *_quantiles(outcome, "model of another device of its family", over_rival("sibling"), (0.8, None, 1.1)),
        _worst(outcome, "model of another family, over the PID: worst", over("stranger", "pid"), 1.1),
        _worst(outcome, "a lag of 0.2 s in the model too many, over the PID: worst", over("wrong_lag", "pid"), 1.1),
        *(_worst(outcome, f"{name}: worst", ratio, 1.05) for name, ratio in learned),
        *(_median(f"{name}: median", by_device(outcome.figures, ratio), 0.5) for name, ratio in learned),
        _worst(
            outcome,
            "without a sensor, as identified, over the inverse: worst",
            over("as_identified_none", "as_identified_inverse"),
            1.2,
        ),
        _band(outcome),
        _worst(outcome, "frames over no sensor: worst", over("imaging", "none"), 1.1),
        *_by_family(outcome, "frames over the PID tuned for them", over("imaging", "imaging_pid"), 0.5),
        _gap(outcome),
        _total(outcome, "samples stopped by a controller that learns", "stops", learns=True),
        _total(outcome, "samples beyond a limit, all controllers", "violations"),
    ]


def _quantiles(
    outcome: CommissionOutcome,
    name: str,
    figure: Callable[[Figures], float],
    limits: tuple[float, float | None, float],
) -> list[Bar]:
    """Median, 90th percentile where it has a limit, and worst."""
    values, levels = by_device(outcome.figures, figure), {"median": 0.5, "90th percentile": 0.9, "worst": 1.0}
    return [
        Bar.at_most(f"{name}: {what}", values, limit, level, None if what == "worst" else ())
        for (what, level), limit in zip(levels.items(), limits, strict=True)
        if limit is not None
    ]


def _worst(outcome: CommissionOutcome, name: str, figure: Callable[[Figures], float], limit: float) -> Bar:
    return Bar.at_most(name, by_device(outcome.figures, figure), limit)


def _median(name: str, values: Figures, limit: float) -> Bar:
    return Bar(name, float(np.median(list(values.values()))), (0.0, limit), len(values), beyond(values, limit))


def _by_family(outcome: CommissionOutcome, name: str, figure: Callable[[Figures], float], limit: float) -> list[Bar]:
    values, judged = by_device(outcome.figures, figure), []
    for family in outcome.settings.families:
        members = [value for device, value in values.items() if outcome.families[device] == family]
        if members:
            judged.append(Bar(f"{name}, {family}: median", float(np.median(members)), (0.0, limit), len(members), ()))
    return judged


def _band(outcome: CommissionOutcome) -> Bar:
    """Share of all samples, with equal weight of each device."""
    shares = by_device(outcome.figures, lambda f: f.get("none.within_band", math.nan))
    known = [share for share in shares.values() if math.isfinite(share)]
    misses = tuple(name for name, share in shares.items() if not 0.85 <= share <= 0.95)
    value = float(np.mean(known)) if known else math.nan
    return Bar("without a sensor, within the band of 90 %", value, (0.85, 0.95), len(known), misses)


def gap_agrees(figures: Figures) -> bool | None:
    """Whether the tracking error fell by the predicted share, within 30 % of it; None without a prediction.

    Where no fall was predicted, the error may change by the floor of the noise, or 30 % of itself, at most.
    """
    if not figures.get("gap.said"):
        return None
    said = TrackingGap(figures["gap.said_before_deg"], figures["gap.said_after_deg"])
    before, after, floor = (figures[f"gap.{name}_deg"] for name in ("before", "after", "floor"))
    if not said.changes(floor):
        return abs(before - after) <= max(floor, AGREEMENT * before)
    return abs(1.0 - after / before - said.fall_share) <= AGREEMENT * abs(said.fall_share)


def _gap(outcome: CommissionOutcome) -> Bar:
    judged = {name: agrees for name, f in outcome.figures.items() if (agrees := gap_agrees(f)) is not None}
    return Bar.share("tracking gap said within 30 %", judged, (0.8, 1.0))


def _total(outcome: CommissionOutcome, name: str, figure: str, learns: bool = False) -> Bar:
    """Samples over all controllers, or only those that learn, since a wrong model without learning may stop latched."""
    totals = {
        device: sum(v for k, v in values.items() if k.endswith(f".{figure}") and not (learns and "_off." in k))
        for device, values in outcome.figures.items()
    }
    return Bar.none(name, totals)
