"""Requirements of the identification study: the numbers behind them, and what is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.trials.types import Vec

from ..blind.bars import Bar
from ..blind.measures import Rate
from .job import IdentifyResult
from .settings import IdentifySettings

TUNED = ("pid", "inverse_pid")
CONTROLLERS = ("linearised", "sampling", "exact", "inverse", *TUNED)
PARTS = ("lag", "delay", "creep")
NEAR_EXACT = 1.25


@dataclass(frozen=True, eq=False)
class IdentifyOutcome:
    """The study with the results of all its devices."""

    settings: IdentifySettings
    results: tuple[IdentifyResult, ...]
    folder: Path
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> tuple[IdentifyResult, ...]:
        """Results that hold an error."""
        return tuple(result for result in self.results if result.status == "failed")

    @cached_property
    def done(self) -> tuple[IdentifyResult, ...]:
        """Results that went through."""
        return tuple(result for result in self.results if result.status == "done")


Figure = Callable[[IdentifyResult], float]


def rmse(result: IdentifyResult, controller: str) -> float:
    """RMSE of a controller over the three motions [deg]."""
    return result.figures[f"{controller}.rmse_deg"]


def over_best(result: IdentifyResult) -> float:
    """RMSE of the default controller over that of the better tuned rival."""
    return rmse(result, "linearised") / min(rmse(result, name) for name in TUNED)


def over(controller: str, other: str) -> Figure:
    """RMSE of a controller over that of another."""
    return lambda result: rmse(result, controller) / rmse(result, other)


def at_rest(result: IdentifyResult) -> float:
    """Share of the settled hold time in which the default controller's command rests."""
    return result.figures["linearised.rest_samples"] / max(result.figures["linearised.hold_samples"], 1.0)


def covered(result: IdentifyResult, part: str) -> bool | None:
    """Whether what was drawn lies within the 90 % interval; None where nothing was drawn or the model is another one.

    Lag and delay of a servo are no such numbers: its drive is of second order.
    """
    if result.truth[part] == 0 or (part != "creep" and result.facts["servo_damping"]):
        return None
    if part not in result.found:
        return False
    _, low, high = result.found[part]
    return low <= result.truth[part] <= high


def invented(result: IdentifyResult, part: str) -> bool | None:
    """Whether a part was found on a device that has none; None where it has one."""
    return None if result.truth[part] else part in result.found


def bars(outcome: IdentifyOutcome) -> list[Bar]:
    """All bars; a device whose study failed counts as infinitely bad in ratios."""
    ratios, lost = _values(outcome, over_best), tuple(result.job.key for result in outcome.failed)
    sampling = _values(outcome, over("sampling", "linearised"))
    known = _values(outcome, over("as_identified_linearised", "as_identified_inverse"))
    count = len(outcome.results)
    return [
        Bar("ratio to the best tuned rival: median", _quantile(ratios, 0.5), (0.0, 0.5), count, lost),
        Bar("ratio to the best tuned rival: 90th percentile", _quantile(ratios, 0.9), (0.0, 0.8), count, lost),
        Bar("ratio to the best tuned rival: worst", *_worst(outcome, ratios, 1.1)),
        _near(outcome),
        Bar("sampling over linearised: worst", *_worst(outcome, sampling, 1.1)),
        Bar("as identified, over the inverse alone: worst", *_worst(outcome, known, 1.1)),
        *(_share(outcome, f"{part} within its 90 % interval", part, covered, (0.85, 0.95)) for part in PARTS),
        *(_share(outcome, f"{part} invented", part, invented, (0.0, 0.05)) for part in PARTS),
        _rest("settled hold time at rest", outcome.done),
        _rest("settled hold time at rest, without creep", [r for r in outcome.done if not r.truth["creep"]]),
        _violations(outcome),
    ]


def _values(outcome: IdentifyOutcome, figure: Figure) -> Vec:
    return np.array([figure(r) if r.status == "done" else math.inf for r in outcome.results])


def _quantile(values: Vec, level: float) -> float:
    """Order statistic: at least this share of the values is no greater; infinite ones can be ranked."""
    return float(np.sort(values)[math.ceil(level * values.size) - 1])


def _worst(
    outcome: IdentifyOutcome, values: Vec, limit: float
) -> tuple[float, tuple[float, float], int, tuple[str, ...]]:
    beyond = tuple(r.job.key for r, value in zip(outcome.results, values, strict=True) if not value <= limit)
    return float(np.max(values)), (0.0, limit), values.size, beyond


def _near(outcome: IdentifyOutcome) -> Bar:
    values = _values(outcome, over("linearised", "exact"))
    near = Rate(int(np.sum(values <= NEAR_EXACT)), values.size)
    far = tuple(r.job.key for r, value in zip(outcome.results, values, strict=True) if not value <= NEAR_EXACT)
    return Bar(f"share within {NEAR_EXACT} of the exact one", near.value, (0.8, 1.0), values.size, far, near.ci90)


def _share(
    outcome: IdentifyOutcome,
    name: str,
    part: str,
    hit: Callable[[IdentifyResult, str], bool | None],
    wanted: tuple[float, float],
) -> Bar:
    """Share of the devices that a part is judged on; the devices named are those of the smaller side."""
    judged = [(result.job.key, said) for result in outcome.done if (said := hit(result, part)) is not None]
    found = Rate(sum(said for _, said in judged), len(judged))
    named = tuple(key for key, said in judged if said == (hit is invented))
    return Bar(name, found.value, wanted, len(judged), named, found.ci90)


def _rest(name: str, results: Sequence[IdentifyResult]) -> Bar:
    """Share over devices; where the angle creeps, the command has to follow for the tip to stand still."""
    samples = sum(result.figures["linearised.hold_samples"] / float(result.facts["rate_hz"]) for result in results)
    still = sum(result.figures["linearised.rest_samples"] / float(result.facts["rate_hz"]) for result in results)
    restless = tuple(result.job.key for result in results if at_rest(result) < 0.99)
    return Bar(name, still / samples if samples else math.nan, (0.99, 1.0), len(results), restless)


def _violations(outcome: IdentifyOutcome) -> Bar:
    totals = {r.job.key: sum(r.figures[f"{name}.violations"] for name in CONTROLLERS) for r in outcome.done}
    beyond = tuple(key for key, total in totals.items() if total)
    return Bar("samples beyond a limit, all controllers", sum(totals.values()), (0.0, 0.0), len(totals), beyond)


def summary(outcome: IdentifyOutcome, family: str | None = None) -> Mapping[str, float]:
    """Medians over the devices of a family, or all."""
    results: Sequence[IdentifyResult] = [r for r in outcome.done if family in (None, r.facts["family"])]
    figures: Mapping[str, Figure] = {
        "ratio": over_best,
        "over exact": over("linearised", "exact"),
        "sampling over linearised": over("sampling", "linearised"),
        "inverse over best": lambda r: rmse(r, "inverse") / min(rmse(r, name) for name in TUNED),
        "exact over best": lambda r: rmse(r, "exact") / min(rmse(r, name) for name in TUNED),
        "at rest": at_rest,
    }
    medians = {
        name: float(np.median([figure(r) for r in results])) if results else math.nan
        for name, figure in figures.items()
    }
    return {"devices": float(len(results)), **medians}
