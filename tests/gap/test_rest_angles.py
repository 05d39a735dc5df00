"""Trials begin at one angle only where no motion can be why their angles at rest differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.logs.preparation import common_rest
from hystmpc.models.identify.runs import Run

from .engine_examples import device_runs

RUN = device_runs()[0]
SHIFTS = st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=9)


def runs_with(shifts: list[float], change: float, back: bool = True) -> tuple[Run, ...]:
    """Trials that rest at 30 deg more than their shift, and after a motion at `change` deg more than that."""
    there = np.concatenate([np.zeros(10), np.linspace(0.0, 5.0, 50), np.full(20, 0.0 if back else 5.0)])
    made = []
    for k, shift in enumerate(shifts):
        angle = 30.0 + shift + 8.0 * there
        angle[60:] += change
        counts = np.ones(there.size, dtype=bool)
        made.append(
            replace(
                RUN, name=str(k), command=there, angle=angle, rest_angle=30.0 + shift, rest_command=0.0, counts=counts
            )
        )
    return tuple(made)


@given(SHIFTS, st.floats(0.01, 3.0), st.floats(0.0, 4.0))
def test_one_angle_exactly_where_trials_differ_by_three_times_what_motions_change(
    shifts: list[float], change: float, form_mse: float
) -> None:
    runs = runs_with(shifts, change)
    found = common_rest(runs, form_mse)
    spread = float(np.ptp(shifts))
    beyond = spread > max(3 * change, 2 * form_mse**0.5)
    if min(abs(spread - 3 * change), abs(spread - 2 * form_mse**0.5)) > 1e-6:
        assert (found == runs) == (not beyond)
        assert not beyond or {run.rest_angle for run in found} == {runs[0].rest_angle}
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(found, runs, strict=True))


def test_trials_that_do_not_come_back_or_rest_elsewhere_keep_their_own() -> None:
    far = runs_with([0.0, 0.0, 9.0, 9.0], 0.1, back=False)
    assert common_rest(far, 0.0) == far
    apart = tuple(replace(run, rest_command=float(k)) for k, run in enumerate(runs_with([0.0, 0.0, 9.0, 9.0], 0.1)))
    assert common_rest(apart, 0.0) == apart
