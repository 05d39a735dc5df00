"""All that a finished benchmark knows, and its ratios."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from .plants import PLANTS
from .result import ControlResult
from .rivals import BASELINES, CONTROLLERS, ORACLE
from .settings import ControlSettings

Run = tuple[str, float, str, str]


@dataclass(frozen=True, eq=False)
class ControlOutcome:
    """The benchmark with the results of all its jobs.

    Attributes:
        settings: of the study.
        results: in the order of its jobs.
        folder: where results and signals lie.
        meta: of the run folder.
    """

    settings: ControlSettings
    results: tuple[ControlResult, ...]
    folder: Path
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> tuple[ControlResult, ...]:
        """Results that hold an error."""
        return tuple(result for result in self.results if result.status == "failed")

    @cached_property
    def runs(self) -> tuple[ControlResult, ...]:
        """Controllers along motions, those that went through."""
        return tuple(result for result in self.results if result.job.stage == "run" and result.status == "done")

    @cached_property
    def by_name(self) -> Mapping[Run, ControlResult]:
        """Runs by plant, rate, controller and motion."""
        return {(r.job.plant, r.job.rate_hz, r.job.subject, r.job.motion): r for r in self.runs}

    @property
    def loops(self) -> tuple[tuple[str, float], ...]:
        """Plants and rates that were run, in order."""
        return tuple(dict.fromkeys((run.job.plant, run.job.rate_hz) for run in self.runs))

    def rmse(self, like: ControlResult, controller: str) -> float:
        """RMSE of a controller on the same plant, rate and motion; NaN where it was not run [deg]."""
        job = like.job
        found = self.by_name.get((job.plant, job.rate_hz, controller, job.motion))
        return math.nan if found is None else found.figures["rmse_deg"]

    def over_oracle(self, run: ControlResult) -> float:
        """RMSE over the oracle's; NaN where it was not run."""
        return _over(run.figures["rmse_deg"], self.rmse(run, ORACLE))

    def baseline(self, run: ControlResult) -> float:
        """RMSE of the best of PID, inverse, inverse and PID; NaN unless all three were run [deg]."""
        values = [self.rmse(run, name) for name in BASELINES]
        return math.nan if any(math.isnan(value) for value in values) else min(values)

    def over_baseline(self, run: ControlResult) -> float:
        """RMSE over the best of PID, inverse, inverse and PID; NaN unless all three were run."""
        return _over(run.figures["rmse_deg"], self.baseline(run))


def exact(run: ControlResult) -> bool:
    """Whether the controller's model is the plant, and the plant has no lag, delay, noise or creep."""
    plant, rival = PLANTS[run.job.plant], CONTROLLERS[run.job.subject]
    knows = rival.oracle or (rival.model == "backlash" and plant.library == "backlash" and not plant.off)
    return plant.ideal and knows


def _over(value: float, reference: float) -> float:
    return value / reference if reference > 0 else math.nan
