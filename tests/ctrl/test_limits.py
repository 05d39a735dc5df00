"""Laws of the hard limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.command import CommandLimits
from hystmpc.trials.errors import ControllerError

LIMITS = CommandLimits(-1.0, 6.0, 12.0)
DT = 0.04
GRAIN = 1e-7 * LIMITS.rate * DT  # of the commands of plans
LIMITS.clip_plans(np.zeros(1), 0.0, DT)  # loads the engine, which may take longer than an example should


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20), st.floats(-1.0, 6.0))
def test_plans_are_clipped_as_single_commands_are_but_for_their_grain(plan: list[float], last: float) -> None:
    clipped = LIMITS.clip_plans(np.array([plan, plan[::-1]]), last, DT)
    for row, wanted in zip(clipped, (plan, plan[::-1]), strict=True):
        previous = last
        for got, want in zip(row, wanted, strict=True):
            previous = LIMITS.clip(want, previous, DT)
            assert got == pytest.approx(previous, abs=1.01 * GRAIN)


@given(st.floats(-1.0, 6.0), st.integers(0, 8), st.sampled_from([-1.0, 1.0]), st.floats(-1e-15, 1e-15))
def test_a_plan_that_has_arrived_does_not_move(last: float, moves: int, side: float, rounding: float) -> None:
    """Not by rounding either: at rest the slope of a rate-dependent model hangs on the side of the move."""
    reached = last + side * LIMITS.rate * DT * np.minimum(np.arange(1, 21), moves)
    ramp = LIMITS.clip_plans(reached + rounding * np.arange(20), last, DT)
    ends = np.abs(ramp) == np.where(side > 0, 6.0, 1.0)  # the last digit to a limit may take a sample more
    still = np.diff(ramp[max(moves - 1, 0) :]) == 0.0
    assert np.all(still | ends[max(moves, 1) :])


@given(st.lists(st.floats(-5.0, 10.0), min_size=1, max_size=20), st.floats(-1.0, 6.0))
def test_clipping_twice_is_clipping_once_but_for_the_grain(plan: list[float], last: float) -> None:
    once = LIMITS.clip_plans(np.array(plan), last, DT)
    np.testing.assert_allclose(LIMITS.clip_plans(once, last, DT), once, rtol=0.0, atol=GRAIN)


@given(st.floats(allow_nan=True), st.floats(-1e3, 1e3), st.floats(1e-3, 0.5))
def test_a_clipped_command_is_within_the_box_wherever_the_last_one_was(u: float, last: float, dt: float) -> None:
    """A device beyond the limits is led back to the nearest of them, within the rate counted from there."""
    low, high = LIMITS.window(last, dt)
    assert LIMITS.lower <= low <= high <= LIMITS.upper
    got = LIMITS.clip(u, last, dt)
    assert low <= got <= high
    assert abs(got - min(max(last, LIMITS.lower), LIMITS.upper)) <= LIMITS.rate * dt * (1 + 1e-12)


@pytest.mark.parametrize("u", [np.nan, np.inf, -np.inf])
def test_command_that_is_not_finite_becomes_the_last_one(u: float) -> None:
    assert LIMITS.clip(u, 2.0, DT) == 2.0


@pytest.mark.parametrize("values", [(1.0, 1.0, 1.0), (0.0, 1.0, 0.0), (0.0, np.inf, 1.0), (np.nan, 1.0, 1.0)])
def test_impossible_limits_are_refused(values: tuple[float, float, float]) -> None:
    with pytest.raises(ControllerError, match="expected finite lower < upper"):
        CommandLimits(*values)
