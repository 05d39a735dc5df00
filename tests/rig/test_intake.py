"""What a reading has to pass before it is believed: one law each, at the border."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.safety.intake import Intake, SensorSettings
from hystmpc.rig.transports.transport import Reading

MS = 1_000_000
SENSOR = SensorSettings(lower_deg=0, upper_deg=120, rate_limit_deg_s=400, age_limit_s=0.1, dead_after_s=0.5)
PERIOD = 40


def at(k: int, angle: float, late_ms: float = 0.0, session: int = 1) -> Reading:
    """Reading k, measured every 40 ms, `late_ms` longer on its way than the fastest."""
    sent = PERIOD * (k + 1)
    return Reading(angle, k, session, sent * MS, round((sent + late_ms) * MS), math.nan)


def begun(samples: int = 3) -> Intake:
    """A judge that has accepted so many good readings, about 30 deg."""
    judge = Intake(SENSOR, 0)
    for k in range(samples):
        assert judge.judge([at(k, 30.0 + 0.01 * k)], PERIOD * (k + 1) * MS, 0.0).faults == ()
    return judge


@given(st.floats(0, 300))
def test_age_counts_the_flight(late_ms: float) -> None:
    now = round((PERIOD * 4 + late_ms) * MS)
    seen = begun().judge([at(3, 30.1, late_ms)], now, 0.0)
    if abs(late_ms - 100) > 1e-3:
        assert (seen.faults == ("stale",)) == (late_ms > 100)


@given(st.floats(0, 300))
def test_age_counts_the_time_since_receipt(waited_ms: float) -> None:
    """A reading that lay in the queue is as old as one that was long on its way."""
    seen = begun().judge([at(3, 30.1)], round((PERIOD * 4 + waited_ms) * MS), 0.0)
    if abs(waited_ms - 100) > 1e-3:
        assert (seen.faults == ("stale",)) == (waited_ms > 100)


@given(st.one_of(st.floats(-1e6, 1e6), st.sampled_from([math.nan, math.inf, -math.inf])))
def test_no_angle_beyond_the_plausible_range_is_accepted(angle: float) -> None:
    """The rate limit is no help here: the angle has had all the time in the world."""
    judge = Intake(SENSOR, 0)
    seen = judge.judge([at(10_000, angle)], PERIOD * 10_001 * MS, 0.0)
    assert math.isnan(seen.angle_deg) == (not 0 <= angle <= 120)


@given(st.floats(0, 120))
def test_an_angle_may_not_move_faster_than_its_limit(angle: float) -> None:
    seen = begun().judge([at(3, angle)], PERIOD * 4 * MS, 0.0)
    moved = abs(angle - 30.02)
    if abs(moved - 16) > 1e-6:
        assert (seen.faults == ("jump",)) == (moved > 16)  # 400 deg/s over 40 ms


def test_a_repeated_or_older_reading_is_not_believed() -> None:
    judge = begun()
    seen = judge.judge([at(2, 30.3), at(1, 30.4)], PERIOD * 4 * MS, 0.0)
    assert seen.faults == ("replayed-or-reordered",)
    assert math.isnan(seen.angle_deg)


def test_a_restarted_device_is_dead_for_good() -> None:
    judge = begun()
    assert "restarted" in judge.judge([at(3, 30.1, session=2)], PERIOD * 4 * MS, 0.0).dead
    assert "restarted" in judge.judge([at(4, 30.1, session=2)], PERIOD * 5 * MS, 0.0).dead


@pytest.mark.parametrize(("step", "frozen"), [(0.1, True), (0.0, False)])
def test_a_repeated_angle_is_frozen_only_while_the_command_travels(step: float, frozen: bool) -> None:
    judge = begun()
    faults = [judge.judge([at(k, 30.02)], PERIOD * (k + 1) * MS, step * k).faults for k in range(3, 20)]
    assert (("frozen",) in faults) == frozen


def test_silence_is_death_after_its_time_and_not_before() -> None:
    judge = begun()
    last = PERIOD * 3
    verdicts = [bool(judge.judge([], (last + ms) * MS, 0.0).dead) for ms in range(20, 800, 20)]
    assert verdicts.index(True) == next(k for k, ms in enumerate(range(20, 800, 20)) if ms > 500)
    assert all(b or not a for a, b in pairwise(verdicts))


@pytest.mark.parametrize(("listens", "held"), [(True, 1.5), (False, math.nan)])
def test_what_a_device_holds_counts_only_where_it_listens_to_this_session(listens: bool, held: float) -> None:
    """What it holds for another controller is no place to start from."""
    intake = Intake(SensorSettings(lower_deg=0.0, upper_deg=120.0), 0)
    seen = intake.judge([Reading(40.0, 1, 1, 0, 0, 1.5, listens)], 0, 1.5)
    assert seen.angle_deg == 40.0
    assert seen.held == pytest.approx(held, nan_ok=True)


def test_what_a_device_holds_counts_also_where_its_sensor_does_not() -> None:
    """A sensor that fails must not hide what the drive does: the stop has to know."""
    intake = Intake(SensorSettings(lower_deg=0.0, upper_deg=120.0), 0)
    seen = intake.judge([Reading(math.nan, 1, 1, 0, 0, 1.5)], 0, 1.5)
    assert math.isnan(seen.angle_deg)
    assert seen.held == 1.5


def test_what_a_stale_reading_tells_does_not_count() -> None:
    intake = Intake(SensorSettings(lower_deg=0.0, upper_deg=120.0), 0)
    old = 200_000_000
    intake.judge([Reading(40.0, 1, 1, 0, 0, 1.5)], 0, 1.5)
    assert math.isnan(intake.judge([Reading(41.0, 2, 1, 40_000_000, old, 1.5)], old + 40_000_000, 1.5).held)
