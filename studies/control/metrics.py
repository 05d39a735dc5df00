"""Figures of one closed-loop run that the benchmark's bars are about."""

from __future__ import annotations

import math

import numpy as np

from hystmpc.ctrl.command import Source
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.sim.closed_loop import ClosedLoopRun
from hystmpc.sim.metrics import holds, tracking_metrics
from hystmpc.trials.types import Vec

HOLD_RANGE_BAR = 0.1
"""Greatest range of a held command, in half-widths of the backlash."""
_CYCLE_REVERSALS = 2  # up, down, up again: one whole period
_JITTER = 0.01  # of the bar: smaller moves are none


def control_figures(
    run: ClosedLoopRun, limits: CommandLimits, half_width: float, preview: int = 0, delay: int = 0
) -> dict[str, float]:
    """Figures by name; NaN for those of holds where there is none.

    `hold_range` is the greatest range of the command over the last half of a hold, in half-widths; `rest_range` is the
    same without the samples whose preview already shows the next move, which a controller may prepare by crossing the
    dead band. `cycling_holds` is the share of holds in which the range exceeds `HOLD_RANGE_BAR` and the command goes to
    and fro. For ranges and cycles a hold begins and ends earlier by the delay: a command acts that much later.
    `fallbacks` are samples whose command did not come from the controller's own law. `late_share` is the share of steps
    that took longer than a sample on the machine as it was loaded; it is shown, and judged nowhere.

    Args:
        run: what happened.
        limits: that the controller had.
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
    own = sum(metrics.ladder.get(source, 0) for source in (Source.CONTROLLER, Source.MPC))
    return {
        "rmse_deg": metrics.rmse_deg,
        "max_deg": metrics.max_abs_deg,
        "hold_error_deg": metrics.hold_error_deg,
        "hold_range": max(ranges, default=math.nan) / half_width,
        "rest_range": max(rests, default=math.nan) / half_width,
        "cycling_holds": float(np.mean(cycling)) if cycling else math.nan,
        "travel": metrics.command_travel,
        "violations": float(metrics.limit_violations),
        "fallbacks": float(len(command) - own),
        "late_share": float(np.mean(run.log.step_s > run.dt)),
        "step_p99_ms": 1e3 * metrics.step_p99_s,
    }


def limit_cycle(command: Vec, band: float) -> bool:
    """Whether a held command (N,) leaves a band [cmd] and turns often enough to go round: two reversals or more."""
    if float(np.ptp(command)) <= band:
        return False
    moves = np.diff(command)
    signs = np.sign(moves[np.abs(moves) > _JITTER * band])
    return int(np.count_nonzero(np.diff(signs))) >= _CYCLE_REVERSALS
