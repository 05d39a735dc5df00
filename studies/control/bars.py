"""The bars of the benchmark: what it must show, computed and told, never asserted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from .metrics import HOLD_RANGE_BAR
from .motions import SCANS_HZ
from .outcome import ControlOutcome, exact
from .result import ControlResult
from .rivals import CONTROLLERS

HOLD_ERROR_DEG = 0.05
SCAN_RMSE_DEG = 0.2
OVER_ORACLE = 1.25
OVER_BASELINE = 0.5
BASELINE_LEAVES = 2.0
"""The baselines' bar counts where the best of them leaves more than this many times the oracle's RMSE."""

Figure = Callable[[ControlOutcome, ControlResult], float]


@dataclass(frozen=True)
class Bar:
    """One requirement: a figure of every run that it is about, and the most that it may be.

    Attributes:
        name: in tables.
        limit: the most that is allowed.
        figure: of a run; NaN where the run has none.
        about: whether a run is judged.
    """

    name: str
    limit: float
    figure: Figure
    about: Figure


@dataclass(frozen=True)
class Verdict:
    """How one controller on one plant at one rate stands to one bar.

    Attributes:
        bar: its name.
        limit: the most that is allowed.
        plant, rate_hz, controller: what is judged.
        within, judged: motions that keep to it, and motions.
        worst: the greatest figure.
        motion: where that was.
    """

    bar: str
    limit: float
    plant: str
    rate_hz: float
    controller: str
    within: int
    judged: int
    worst: float
    motion: str

    @property
    def met(self) -> bool:
        """Whether every motion keeps to the bar."""
        return self.within == self.judged


def _named(name: str) -> Figure:
    return lambda outcome, run: run.figures[name]


def _predictive(run: ControlResult) -> bool:
    return CONTROLLERS[run.job.subject].predictive


def _inexact(outcome: ControlOutcome, run: ControlResult) -> bool:
    del outcome
    return _predictive(run) and not exact(run) and not CONTROLLERS[run.job.subject].oracle


def _beatable(outcome: ControlOutcome, run: ControlResult) -> bool:
    """Whether the baselines leave enough for their bar to count."""
    oracle = outcome.rmse(run, "oracle")
    return _inexact(outcome, run) and outcome.baseline(run) > BASELINE_LEAVES * oracle


BARS: tuple[Bar, ...] = (
    Bar(
        "hold error, exactly known plant [deg]",
        HOLD_ERROR_DEG,
        _named("hold_error_deg"),
        lambda _, r: exact(r) and _predictive(r),
    ),
    Bar(
        "scan RMSE, exactly known plant [deg]",
        SCAN_RMSE_DEG,
        _named("rmse_deg"),
        lambda _, r: exact(r) and _predictive(r) and r.job.motion in SCANS_HZ,
    ),
    Bar("RMSE over the oracle's", OVER_ORACLE, ControlOutcome.over_oracle, _inexact),
    Bar("RMSE over the best of PID, inverse, both", OVER_BASELINE, ControlOutcome.over_baseline, _beatable),
    Bar("range of a held command [half-widths]", HOLD_RANGE_BAR, _named("hold_range"), lambda _, r: _predictive(r)),
    Bar("share of holds with a limit cycle", 0.0, _named("cycling_holds"), lambda _, r: _predictive(r)),
    Bar("samples beyond a limit", 0.0, _named("violations"), lambda _, r: True),
    Bar("samples on a rung of the ladder", 0.0, _named("fallbacks"), lambda _, r: True),
)


def verdicts(outcome: ControlOutcome) -> tuple[Verdict, ...]:
    """Every bar on every controller, plant and rate that it is about."""
    return tuple(verdict for bar in BARS for verdict in _of_bar(bar, outcome))


def _of_bar(bar: Bar, outcome: ControlOutcome) -> Iterable[Verdict]:
    for plant, rate in outcome.loops:
        for controller in outcome.settings.controllers:
            runs = [
                run
                for motion in outcome.settings.motions
                if (run := outcome.by_name.get((plant, rate, controller, motion))) and bar.about(outcome, run)
            ]
            figures = [(bar.figure(outcome, run), run.job.motion) for run in runs]
            known = [(value, motion) for value, motion in figures if not math.isnan(value)]
            if known:
                worst, motion = max(known)
                within = sum(value <= bar.limit for value, _ in known)
                yield Verdict(bar.name, bar.limit, plant, rate, controller, within, len(known), worst, motion)
