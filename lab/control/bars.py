"""Requirements of the benchmark: figures of a run, results of all jobs, and the verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hystmpc.ctrl.command import CommandLimits, Source
from hystmpc.sim.results import holds, tracking_metrics
from hystmpc.sim.study import ClosedLoopRun
from hystmpc.trials.types import Vec

from ..study import Outcome
from .plants import PLANTS
from .settings import BASELINES, CONTROLLERS, ORACLE, SCANS_HZ, ControlResult, ControlSettings

HOLD_RANGE_BAR = 0.1
"""Greatest range of a held command, in half-widths of the backlash."""
_CYCLE_REVERSALS = 2  # up, down, up again: one whole period
_JITTER = 0.01  # of the bar: smaller moves are none
Run = tuple[str, float, str, str]
HOLD_ERROR_DEG = 0.05
SCAN_RMSE_DEG = 0.2
OVER_ORACLE = 1.25
OVER_BASELINE = 0.5
BASELINE_LEAVES = 2.0
"""The baselines' bar counts where the best of them leaves more than this many times the oracle's RMSE."""


def control_figures(
    run: ClosedLoopRun, limits: CommandLimits, half_width: float, preview: int = 0, delay: int = 0
) -> dict[str, float]:
    """Figures of a run by name; figures of holds are NaN if there are none.

    `hold_range` is the greatest range of the command over the last half of a hold, in half-widths; `rest_range` is the
    same without the samples whose preview already shows the next move, which a controller may prepare by crossing the
    dead band. `cycling_holds` is the share of holds in which the range exceeds `HOLD_RANGE_BAR` and the command goes to
    and fro. For ranges and cycles a hold begins and ends earlier by the delay: a command acts that much later.
    `fallbacks` are samples whose command did not come from the controller's own law. `late_share` is the share of steps
    that took longer than a sample on the machine as it was loaded; it is shown, and judged nowhere.

    Args:
        half_width: half the width of the plant's hysteresis loop [cmd].
        preview: samples of the reference that the controller looks ahead.
        delay: samples of transport delay, begun ones included.
    """
    metrics = tracking_metrics(run, limits)
    command = run.log.command
    halves = [(a + (b - a) // 2, b) for a, b in holds(run.log.reference_deg, run.dt)]
    held = [(max(a - delay, 0), b - delay) for a, b in halves]
    ranges = [float(np.ptp(command[a:b])) for a, b in held]
    rests = [float(np.ptp(command[a : b - preview])) for a, b in halves if b - preview > a]
    cycling = [limit_cycle(command[a:b], HOLD_RANGE_BAR * half_width) for a, b in held]
    planned = sum(metrics.ladder.get(source, 0) for source in (Source.CONTROLLER, Source.MPC))
    return {
        "rmse_deg": metrics.rmse_deg,
        "max_deg": metrics.max_abs_deg,
        "hold_error_deg": metrics.hold_error_deg,
        "hold_range": max(ranges, default=math.nan) / half_width,
        "rest_range": max(rests, default=math.nan) / half_width,
        "cycling_holds": float(np.mean(cycling)) if cycling else math.nan,
        "travel": metrics.command_travel,
        "violations": float(metrics.limit_violations),
        "fallbacks": float(len(command) - planned),
        "late_share": float(np.mean(run.log.step_s > run.dt)),
        "step_p99_ms": 1e3 * metrics.step_p99_s,
    }


def limit_cycle(command: Vec, band: float) -> bool:
    """Whether a held command (N,) leaves a band [cmd] with two reversals or more, as in a limit cycle."""
    if float(np.ptp(command)) <= band:
        return False
    moves = np.diff(command)
    signs = np.sign(moves[np.abs(moves) > _JITTER * band])
    return int(np.count_nonzero(np.diff(signs))) >= _CYCLE_REVERSALS


@dataclass(frozen=True, eq=False)
class ControlOutcome(Outcome[ControlSettings, ControlResult]):
    """Benchmark with the results of all its jobs."""

    @cached_property
    def runs(self) -> tuple[ControlResult, ...]:
        """Successful runs of controllers along motions."""
        return tuple(result for result in self.results if result.job.stage == "run" and result.status == "done")

    @cached_property
    def by_name(self) -> Mapping[Run, ControlResult]:
        """Runs by plant, rate, controller and motion."""
        return {(r.job.plant, r.job.rate_hz, r.job.subject, r.job.motion): r for r in self.runs}

    @property
    def loops(self) -> tuple[tuple[str, float], ...]:
        """Plants and rates of the runs, in order."""
        return tuple(dict.fromkeys((run.job.plant, run.job.rate_hz) for run in self.runs))

    def rmse(self, like: ControlResult, controller: str) -> float:
        """RMSE of a controller on the same plant, rate and motion [deg]; NaN without a run."""
        job = like.job
        same = self.by_name.get((job.plant, job.rate_hz, controller, job.motion))
        return math.nan if same is None else same.figures["rmse_deg"]

    def over_oracle(self, run: ControlResult) -> float:
        """RMSE divided by that of the oracle; NaN without its run."""
        return _over(run.figures["rmse_deg"], self.rmse(run, ORACLE))

    def baseline(self, run: ControlResult) -> float:
        """Lowest RMSE of PID, inverse, and inverse with PID [deg]; NaN unless all three were run."""
        values = [self.rmse(run, name) for name in BASELINES]
        return math.nan if any(math.isnan(value) for value in values) else min(values)

    def over_baseline(self, run: ControlResult) -> float:
        """RMSE divided by `baseline`; NaN unless all three baselines were run."""
        return _over(run.figures["rmse_deg"], self.baseline(run))


def exact(run: ControlResult) -> bool:
    """Whether the controller's model is the plant, and the plant has no lag, delay, noise or creep."""
    plant, rival = PLANTS[run.job.plant], CONTROLLERS[run.job.subject]
    knows = rival.oracle or (rival.model == "backlash" and plant.library == "backlash" and not plant.off)
    return plant.ideal and knows


def _over(value: float, reference: float) -> float:
    return value / reference if reference > 0 else math.nan


FigureOfRun = Callable[[ControlOutcome, ControlResult], float]


@dataclass(frozen=True)
class ControlBar:
    """Requirement: a figure of the runs in its scope, and its upper limit."""

    name: str
    limit: float
    figure: FigureOfRun
    about: FigureOfRun


@dataclass(frozen=True)
class BarVerdict:
    """Verdict of one bar on one controller, plant and rate."""

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
        """Whether every motion meets the bar."""
        return self.within == self.judged


def _named(name: str) -> FigureOfRun:
    return lambda outcome, run: run.figures[name]


def _predictive(run: ControlResult) -> bool:
    return CONTROLLERS[run.job.subject].predictive


def _inexact(outcome: ControlOutcome, run: ControlResult) -> bool:
    del outcome
    return _predictive(run) and not exact(run) and not CONTROLLERS[run.job.subject].oracle


def _beatable(outcome: ControlOutcome, run: ControlResult) -> bool:
    """Whether the baselines' error is large enough for their bar to count."""
    oracle = outcome.rmse(run, "oracle")
    return _inexact(outcome, run) and outcome.baseline(run) > BASELINE_LEAVES * oracle


BARS: tuple[ControlBar, ...] = (
    ControlBar(
        "hold error, exactly known plant [deg]",
        HOLD_ERROR_DEG,
        _named("hold_error_deg"),
        lambda _, r: exact(r) and _predictive(r),
    ),
    ControlBar(
        "scan RMSE, exactly known plant [deg]",
        SCAN_RMSE_DEG,
        _named("rmse_deg"),
        lambda _, r: exact(r) and _predictive(r) and r.job.motion in SCANS_HZ,
    ),
    ControlBar("RMSE over the oracle's", OVER_ORACLE, ControlOutcome.over_oracle, _inexact),
    ControlBar("RMSE over the best of PID, inverse, both", OVER_BASELINE, ControlOutcome.over_baseline, _beatable),
    ControlBar(
        "range of a held command [half-widths]", HOLD_RANGE_BAR, _named("hold_range"), lambda _, r: _predictive(r)
    ),
    ControlBar("share of holds with a limit cycle", 0.0, _named("cycling_holds"), lambda _, r: _predictive(r)),
    ControlBar("samples beyond a limit", 0.0, _named("violations"), lambda _, r: True),
    ControlBar("samples on a fallback level", 0.0, _named("fallbacks"), lambda _, r: True),
)


def verdicts(outcome: ControlOutcome) -> tuple[BarVerdict, ...]:
    """Verdicts of every bar on every controller, plant and rate in its scope."""
    return tuple(verdict for bar in BARS for verdict in _of_bar(bar, outcome))


def _of_bar(bar: ControlBar, outcome: ControlOutcome) -> Iterable[BarVerdict]:
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
                yield BarVerdict(bar.name, bar.limit, plant, rate, controller, within, len(known), worst, motion)
