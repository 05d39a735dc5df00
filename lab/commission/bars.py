"""Requirements of the commissioning study: the numbers behind them, and what is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.gap.diagnosis import TrackingGap
from hystmpc.gap.tracking.expected import AGREEMENT
from hystmpc.trials.types import Vec

from ..blind.bars import Bar
from ..blind.measures import Rate
from ..identify.device import FAMILIES
from ..identify.scores import rmse_of
from .job import WORN, CommissionResult
from .settings import CommissionStudySettings

RIVALS = ("pid", "inverse_pid")
MOST_DEVICE_S = 300.0

Figures = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class CommissionOutcome:
    """The study with the results of all its jobs."""

    settings: CommissionStudySettings
    results: tuple[CommissionResult, ...]
    folder: Path
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> tuple[CommissionResult, ...]:
        """Results that hold an error."""
        return tuple(result for result in self.results if result.status == "failed")

    @cached_property
    def figures(self) -> Mapping[str, Figures]:
        """All figures of a device, of both stages, by its name."""
        found: dict[str, dict[str, float]] = {}
        for result in self.results:
            found.setdefault(device_of(result), {}).update(result.figures)
        return found

    @cached_property
    def families(self) -> Mapping[str, str]:
        """Family of each device."""
        return {device_of(result): str(result.facts["family"]) for result in self.results}


def device_of(result: CommissionResult) -> str:
    """Name of a job's device."""
    return result.job.key.removesuffix(f"-{result.job.stage}")


def over_rival(controller: str) -> Callable[[Figures], float]:
    """RMSE of a controller over that of the better tuned rival; infinite where one of them is missing."""
    return lambda f: _ratio(rmse_of(f, controller), min(rmse_of(f, name) for name in RIVALS))


def over(controller: str, other: str) -> Callable[[Figures], float]:
    """RMSE of a controller over that of another."""
    return lambda f: _ratio(rmse_of(f, controller), rmse_of(f, other))


def _ratio(a: float, b: float) -> float:
    return a / b if math.isfinite(a) and b > 0 else math.inf


def bars(outcome: CommissionOutcome) -> list[Bar]:
    """All bars; a device whose job failed counts as infinitely bad."""
    ours, blind = over_rival("commissioned"), over("as_identified_none", "as_identified_inverse")
    return [
        *_quantiles(outcome, "commissioned, over the best tuned rival", ours, (0.5, 0.8, 1.1)),
        _worst(outcome, "device time of a commissioning [s]", lambda f: f.get("device_s", math.inf), MOST_DEVICE_S),
        _worst(outcome, "learning over none, as commissioned: worst", over("commissioned", "learning_off"), 1.05),
        *_quantiles(outcome, "model of another device of its family", over_rival("sibling"), (0.8, None, 1.1)),
        _worst(outcome, "model of another family, over the PID: worst", over("stranger", "pid"), 1.1),
        _worst(outcome, "a lag of 0.2 s in the model too many, over the PID: worst", over("wrong_lag", "pid"), 1.1),
        *(
            _worst(outcome, f"{name} changed, learning over none: worst", over(name, f"{name}_off"), 1.05)
            for name in WORN
        ),
        *(
            _median(outcome, f"{name} changed, learning over none: median", over(name, f"{name}_off"), 0.5)
            for name in WORN
        ),
        _worst(outcome, "without a sensor, as identified, over the inverse: worst", blind, 1.2),
        _band(outcome),
        _worst(outcome, "frames over no sensor: worst", over("imaging", "none"), 1.1),
        *_by_family(outcome, "frames over the PID tuned for them", over("imaging", "imaging_pid"), 0.5),
        _gap(outcome),
        _stops(outcome),
        _violations(outcome),
    ]


def _values(outcome: CommissionOutcome, figure: Callable[[Figures], float]) -> tuple[tuple[str, ...], Vec]:
    names = tuple(outcome.figures)
    return names, np.array([figure(outcome.figures[name]) for name in names])


def _quantiles(
    outcome: CommissionOutcome,
    name: str,
    figure: Callable[[Figures], float],
    limits: tuple[float, float | None, float],
) -> list[Bar]:
    """Median, 90th percentile where it has a limit, and worst."""
    names, values = _values(outcome, figure)
    ranked, found = np.sort(values), []
    for what, level, limit in zip(("median", "90th percentile", "worst"), (0.5, 0.9, 1.0), limits, strict=True):
        if limit is None:
            continue
        beyond = tuple(n for n, v in zip(names, values, strict=True) if not v <= limit) if what == "worst" else ()
        value = float(ranked[math.ceil(level * ranked.size) - 1])
        found.append(Bar(f"{name}: {what}", value, (0.0, limit), values.size, beyond))
    return found


def _worst(outcome: CommissionOutcome, name: str, figure: Callable[[Figures], float], limit: float) -> Bar:
    names, values = _values(outcome, figure)
    beyond = tuple(n for n, v in zip(names, values, strict=True) if not v <= limit)
    return Bar(name, float(np.max(values)), (0.0, limit), values.size, beyond)


def _median(outcome: CommissionOutcome, name: str, figure: Callable[[Figures], float], limit: float) -> Bar:
    names, values = _values(outcome, figure)
    beyond = tuple(n for n, v in zip(names, values, strict=True) if not v <= limit)
    return Bar(name, float(np.median(values)), (0.0, limit), values.size, beyond)


def _by_family(outcome: CommissionOutcome, name: str, figure: Callable[[Figures], float], limit: float) -> list[Bar]:
    """Median over the devices of each family."""
    names, values = _values(outcome, figure)
    found = []
    for family in FAMILIES:
        own = [v for n, v in zip(names, values, strict=True) if outcome.families[n] == family]
        if own:
            found.append(Bar(f"{name}, {family}: median", float(np.median(own)), (0.0, limit), len(own), ()))
    return found


def _band(outcome: CommissionOutcome) -> Bar:
    """Share of all samples, each device counting alike."""
    names, values = _values(outcome, lambda f: f.get("none.within_band", math.nan))
    known = np.isfinite(values)
    beyond = tuple(n for n, v in zip(names, values, strict=True) if not 0.85 <= v <= 0.95)
    share = float(np.mean(values[known])) if known.any() else math.nan
    return Bar("without a sensor, within the band of 90 %", share, (0.85, 0.95), int(known.sum()), beyond)


def gap_agrees(figures: Figures) -> bool | None:
    """Whether the tracking error fell on the device by the share that was said, give or take 30 % of it; None unsaid.

    Where no fall was said, the error may fall or rise by no more than the floor of the noise, or 30 % of itself.
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
    rate = Rate(sum(judged.values()), len(judged))
    beyond = tuple(name for name, agrees in judged.items() if not agrees)
    return Bar("tracking gap said within 30 %", rate.value, (0.8, 1.0), len(judged), beyond, rate.ci90)


def _stops(outcome: CommissionOutcome) -> Bar:
    """Without learning the model of another device may end in the latched stop, as it should."""
    return _total(outcome, "samples stopped by a controller that learns", "stops", lambda key: "_off." not in key)


def _violations(outcome: CommissionOutcome) -> Bar:
    return _total(outcome, "samples beyond a limit, all controllers", "violations")


def _total(outcome: CommissionOutcome, name: str, figure: str, counts: Callable[[str], bool] = lambda key: True) -> Bar:
    totals = {
        device: sum(value for key, value in figures.items() if key.endswith(f".{figure}") and counts(key))
        for device, figures in outcome.figures.items()
    }
    beyond = tuple(device for device, total in totals.items() if total)
    return Bar(name, sum(totals.values()), (0.0, 0.0), len(totals), beyond)
