"""Settings, results and requirements of the identification study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from hystmpc.models.kinds.catalogue import chosen_kind

from ..devices.drawn import DrawnSettings
from ..page import Bar, Figures, over
from ..study import Figure, Outcome, Result

Interval = tuple[Figure, Figure, Figure]


class IdentifySettings(DrawnSettings):
    """Settings of the study `identify`.

    Attributes:
        kind: of model that is identified, by name, see `hystmpc fit`.
        drive: of a kind without one of its own: `auto` identifies the drive, see `hystmpc fit --drive`.
    """

    QUICK: ClassVar[Mapping[str, Any]] = {"devices": 4, "evaluations": 12}
    study: Literal["identify"] = "identify"
    kind: str = "auto"
    drive: str | None = None

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
        figures: see `job.scores`, by controller and figure such as `linearised.rmse_deg`; seconds by stage.
    """

    job: IdentifyJob
    truth: Mapping[str, float] = field(default_factory=dict)
    found: Mapping[str, Interval] = field(default_factory=dict)
    facts: Mapping[str, str | float] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)


TUNED = ("pid", "inverse_pid")
CONTROLLERS = ("linearised", "sampling", "exact", "inverse", *TUNED)
PARTS = ("lag", "delay", "creep")
NEAR_EXACT = 1.25
IdentifyOutcome = Outcome[IdentifySettings, IdentifyResult]

over_best = over("linearised", *TUNED)
over_exact = over("linearised", "exact")
sampling_over_linearised = over("sampling", "linearised")
as_identified = over("as_identified_linearised", "as_identified_inverse")


def at_rest(figures: Figures) -> float:
    """Share of the settled hold time in which the default controller's command rests."""
    return figures["linearised.rest_samples"] / max(figures["linearised.hold_samples"], 1.0)


def covered(result: IdentifyResult, part: str) -> bool | None:
    """Whether the true value lies within the 90 % interval; None without a true value or for another model.

    Lag and delay of a servo have no true values: its drive is of second order.
    """
    if result.truth[part] == 0 or (part != "creep" and result.facts["servo_damping"]):
        return None
    if part not in result.found:
        return False
    _, low, high = result.found[part]
    return low <= result.truth[part] <= high


def invented(result: IdentifyResult, part: str) -> bool | None:
    """Whether a part was identified, its interval without 0, on a device without it; None on a device with it."""
    if result.truth[part]:
        return None
    _, low, high = result.found.get(part, (0.0, 0.0, 0.0))
    return not low <= 0.0 <= high


def bars(outcome: IdentifyOutcome) -> list[Bar]:
    """All bars of the study; a device with a failed job counts as infinitely bad in ratios."""
    ratios, lost = _values(outcome, over_best), tuple(result.job.key for result in outcome.failed)
    near = {key: ratio <= NEAR_EXACT for key, ratio in _values(outcome, over_exact).items()}
    totals = {r.job.key: sum(r.figures[f"{name}.violations"] for name in CONTROLLERS) for r in outcome.done}
    return [
        Bar.at_most("ratio to the best tuned rival: median", ratios, 0.5, 0.5, lost),
        Bar.at_most("ratio to the best tuned rival: 90th percentile", ratios, 0.8, 0.9, lost),
        Bar.at_most("ratio to the best tuned rival: worst", ratios, 1.1),
        Bar.share(f"share within {NEAR_EXACT} of the exact one", near, (0.8, 1.0)),
        Bar.at_most("sampling over linearised: worst", _values(outcome, sampling_over_linearised), 1.1),
        Bar.at_most("as identified, over the inverse alone: worst", _values(outcome, as_identified), 1.1),
        *(
            Bar.share(f"{part} within its 90 % interval", _judged(outcome, part, covered), (0.85, 0.95))
            for part in PARTS
        ),
        *(Bar.share(f"{part} invented", _judged(outcome, part, invented), (0.0, 0.05), counted=True) for part in PARTS),
        _rest("settled hold time at rest", outcome.done),
        _rest("settled hold time at rest, without creep", [r for r in outcome.done if not r.truth["creep"]]),
        Bar.none("samples beyond a limit, all controllers", totals),
    ]


def _values(outcome: IdentifyOutcome, figure: Callable[[Figures], float]) -> Figures:
    return {r.job.key: figure(r.figures) if r.status == "done" else math.inf for r in outcome.results}


def _judged(
    outcome: IdentifyOutcome, part: str, hit: Callable[[IdentifyResult, str], bool | None]
) -> Mapping[str, bool]:
    """Devices on which a part is judged."""
    return {result.job.key: said for result in outcome.done if (said := hit(result, part)) is not None}


def _rest(name: str, results: Sequence[IdentifyResult]) -> Bar:
    """Bar on the share of settled hold time at rest; with creep the command must move to keep the tip still."""
    samples = sum(result.figures["linearised.hold_samples"] / float(result.facts["rate_hz"]) for result in results)
    still = sum(result.figures["linearised.rest_samples"] / float(result.facts["rate_hz"]) for result in results)
    restless = tuple(result.job.key for result in results if at_rest(result.figures) < 0.99)
    return Bar(name, still / samples if samples else math.nan, (0.99, 1.0), len(results), restless)


_MEDIANS: Mapping[str, Callable[[Figures], float]] = {
    "ratio": over_best,
    "over exact": over_exact,
    "sampling over linearised": sampling_over_linearised,
    "inverse over best": over("inverse", *TUNED),
    "exact over best": over("exact", *TUNED),
    "at rest": at_rest,
}


def summary(outcome: IdentifyOutcome, family: str | None = None) -> Mapping[str, float]:
    """Medians over the devices of a family, or all."""
    results = [r.figures for r in outcome.done if family in (None, r.facts["family"])]
    medians = {
        name: float(np.median([of(f) for f in results])) if results else math.nan for name, of in _MEDIANS.items()
    }
    return {"devices": float(len(results)), **medians}
