"""How well one closed-loop run tracked, in figures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trials.types import Vec

from .closed_loop import ClosedLoopRun

HOLD_S = 0.5
_STILL_DEG = 1e-9
_ROUNDING = 1e-9  # of the command's range: a limit that is met exactly is not violated


@dataclass(frozen=True)
class TrackingMetrics:
    """Figures of one run. Errors are true angle less reference; a hold is a reference at rest for 0.5 s or longer.

    Attributes:
        rmse_deg: root mean square error over the whole run [deg].
        max_abs_deg: greatest absolute error [deg].
        hold_error_deg: mean absolute error over the last halves of all holds; NaN without a hold [deg].
        hold_command_range: greatest range of the command over the last half of a hold; NaN without a hold [cmd].
        command_travel: sum of all command changes [cmd].
        limit_violations: samples whose command or command change is beyond the limits; anything but 0 is a fault.
        step_mean_s, step_p99_s: execution time of a controller step, mean and 99th percentile [s].
        ladder: samples by source of the command.
    """

    rmse_deg: float
    max_abs_deg: float
    hold_error_deg: float
    hold_command_range: float
    command_travel: float
    limit_violations: int
    step_mean_s: float
    step_p99_s: float
    ladder: Mapping[str, int]


def tracking_metrics(run: ClosedLoopRun, limits: CommandLimits) -> TrackingMetrics:
    """Metrics of one run under the limits that its controller had."""
    error, command = run.error_deg, run.log.command
    halves = [(start + (stop - start) // 2, stop) for start, stop in holds(run.log.reference_deg, run.dt)]
    still = np.concatenate([np.abs(error[a:b]) for a, b in halves]) if halves else np.array([math.nan])
    step = run.log.step_s
    return TrackingMetrics(
        rmse_deg=math.sqrt(float(np.mean(error**2))),
        max_abs_deg=float(np.max(np.abs(error))),
        hold_error_deg=float(np.mean(still)),
        hold_command_range=max((float(np.ptp(command[a:b])) for a, b in halves), default=math.nan),
        command_travel=float(np.sum(np.abs(np.diff(command, prepend=run.rest_command)))),
        limit_violations=violations(command, run.rest_command, limits, run.dt),
        step_mean_s=float(np.mean(step)),
        step_p99_s=float(np.quantile(step, 0.99)),
        ladder=dict(Counter(run.log.source)),
    )


def holds(reference_deg: Vec, dt_s: float) -> list[tuple[int, int]]:
    """Start and stop (exclusive) of every stretch of at least 0.5 s over which the reference rests."""
    still = np.abs(np.diff(reference_deg)) <= _STILL_DEG
    edges = np.diff(np.concatenate(([0], still.astype(np.int8), [0])))
    pairs = zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    return [(a, b + 1) for a, b in pairs if (b - a) * dt_s >= HOLD_S - _ROUNDING]


def violations(command: Vec, before: float, limits: CommandLimits, dt_s: float) -> int:
    """Samples whose command, or its change from the one before, is not finite or beyond the limits."""
    slack = _ROUNDING * (limits.upper - limits.lower)
    inside = (command >= limits.lower - slack) & (command <= limits.upper + slack)
    slow = np.abs(np.diff(command, prepend=before)) <= limits.rate * dt_s + slack
    return int(np.sum(~(inside & slow)))
