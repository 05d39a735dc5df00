"""Metrics on runs small enough to be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import LoopLog
from hystmpc.sim.results import holds, tracking_metrics, violations
from hystmpc.sim.study import ClosedLoopRun

DT = 0.1
LIMITS = CommandLimits(0.0, 6.0, 10.0)


def run(reference: list[float], true: list[float], command: list[float]) -> ClosedLoopRun:
    """A run of which only these three signals matter."""
    n = len(reference)
    log = LoopLog(
        time_s=DT * np.arange(1, n + 1),
        reference_deg=np.array(reference),
        measured_deg=np.full(n, 1e3),  # metrics are made of true angles
        predicted_deg=np.full(n, math.nan),
        command=np.array(command),
        disturbance_deg=np.zeros(n),
        source=("mpc",) * (n - 1) + ("hold",),
        status=("ok",) * n,
        stage_s={"solve": 1e-3 * np.arange(n), "advance": np.full(n, 1e-3)},
        interrupted=False,
    )
    return ClosedLoopRun(log, np.array(true), rest_command=0.0, dt=DT, unit="mm")


def test_figures_of_a_hand_made_run() -> None:
    reference = [1.0, 2.0, *[3.0] * 8]
    true = [1.0, 4.0, *[3.0] * 4, 3.1, 2.9, 3.3, 2.7]
    command = [0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.2, 1.1, 1.2, 1.2]
    m = tracking_metrics(run(reference, true, command), LIMITS)
    assert m.rmse_deg == pytest.approx(math.sqrt((4 + 0.01 + 0.01 + 0.09 + 0.09) / 10))
    assert m.max_abs_deg == pytest.approx(2.0)
    assert m.hold_error_deg == pytest.approx((0.1 + 0.1 + 0.3 + 0.3) / 4)
    assert m.hold_command_range == pytest.approx(0.1)
    assert m.command_travel == pytest.approx(1.0 + 0.2 + 0.1 + 0.1)
    assert m.limit_violations == 0
    assert m.step_mean_s == pytest.approx(5.5e-3)
    assert m.step_p99_s == pytest.approx(9.91e-3)
    assert m.ladder == {"mpc": 9, "hold": 1}


def test_without_a_hold_there_are_no_hold_figures() -> None:
    m = tracking_metrics(run([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0]), LIMITS)
    assert math.isnan(m.hold_error_deg)
    assert math.isnan(m.hold_command_range)


def test_holds_last_at_least_half_a_second() -> None:
    reference = np.array([0.0, 1.0, *[2.0] * 6, 3.0, *[4.0] * 4, 5.0, *[6.0] * 7])
    assert holds(reference, DT) == [(2, 8), (14, 21)]


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 0),
        ([1.5, 1.5], 1),  # from the rest at 0 in 0.1 s at 10 mm/s
        ([1.0, 2.1, 2.1], 1),
        ([-0.1, 0.0], 1),
        ([1.0, math.nan, 1.0], 2),
    ],
)
def test_violations_of_box_and_rate_are_counted(command: list[float], expected: int) -> None:
    assert violations(np.array(command), 0.0, LIMITS, DT) == expected
