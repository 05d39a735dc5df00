"""What a reading has to pass before it is believed: one law each, at the border."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hystmpc.rig.safety.intake import Intake, Observation, SensorSettings
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


def frozen_after(samples: int, step: float) -> list[Observation]:
    """What is seen of a sensor with noise that freezes after so many samples, while the command then steps."""
    judge = Intake(SENSOR, 0)
    for k in range(samples):
        judge.judge([at(k, 30.0 + 0.01 * math.sin(2.0 * k))], PERIOD * (k + 1) * MS, 0.0)
    later = range(samples, samples + 60)
    return [judge.judge([at(k, 30.02)], PERIOD * (k + 1) * MS, step * (k - samples)) for k in later]


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
    assert (("frozen",) in [s.faults for s in frozen_after(12, step)]) == frozen


def test_silence_is_death_after_its_time_and_not_before() -> None:
    judge = begun()
    last = PERIOD * 3
    verdicts = [bool(judge.judge([], (last + ms) * MS, 0.0).dead) for ms in range(20, 800, 20)]
    assert verdicts.index(True) == next(k for k, ms in enumerate(range(20, 800, 20)) if ms > 500)
    assert all(b or not a for a, b in pairwise(verdicts))


@given(
    growth=st.floats(0.001, 0.5),
    rate_hz=st.sampled_from([10.0, 25.0, 100.0, 1000.0]),
    begins_s=st.floats(0.0, 2.0),
)
@settings(max_examples=20)
def test_a_delay_that_grows_is_seen_however_slowly(growth: float, rate_hz: float, begins_s: float) -> None:
    """No angle is older than its limit and what two clocks may have drifted apart, at any rate of the readings."""
    judge, dt = Intake(SENSOR, 0), 1.0 / rate_hz
    for k in range(1, round(min(begins_s + 0.3 / growth, 20.0) * rate_hz)):
        sent = k * dt
        late = growth * (max(sent - begins_s, 0.0) - max(dt - begins_s, 0.0))  # than the first one
        come = round(1e9 * (sent + late))
        one = Reading(30.0 + 0.01 * math.sin(k), k, 1, round(1e9 * sent), come, math.nan)
        accepted = math.isfinite(judge.judge([one], come, 0.0).angle_deg)
        assert late <= 0.1 + 1e-3 * (sent + late) or not accepted


@given(ppm=st.floats(-300.0, 300.0), jitter_ms=st.floats(0.0, 30.0))
@settings(max_examples=10)
def test_clocks_that_drift_apart_are_no_delay(ppm: float, jitter_ms: float) -> None:
    judge = Intake(SENSOR, 0)
    for k in range(1, 5000):  # readings twice a second, for 40 minutes
        sent = round(0.5e9 * k)
        come = round(0.5e9 * k * (1.0 + 1e-6 * ppm) + 1e6 * jitter_ms * (0.5 + 0.5 * math.sin(1.7 * k**2)))
        seen = judge.judge([Reading(30.0 + 0.01 * math.sin(k), k, 1, sent, come, math.nan)], come, 0.0)
        assert "stale" not in seen.faults


def stream(judge: Intake, angles: Sequence[float], rate_hz: float, loop_hz: float = 25.0) -> list[Observation]:
    """What a loop sees of a sensor that shows these angles, one after another."""
    seen, done = list[Observation](), 0
    for k in range(1, math.floor(len(angles) / rate_hz * loop_hz) + 1):
        now = k / loop_hz
        come = [(i, round(1e9 * (i + 1) / rate_hz)) for i in range(done, min(math.floor(now * rate_hz), len(angles)))]
        done += len(come)
        readings = [Reading(angles[i], i, 1, ns, ns, math.nan) for i, ns in come]
        seen.append(judge.judge(readings, round(1e9 * now), 0.0))
    return seen


@given(
    rate_hz=st.sampled_from([25.0, 100.0, 1000.0, 5000.0]),
    noise_deg=st.floats(0.0, 0.5),
    seed=st.integers(0, 1000),
    speed=st.floats(0.0, 350.0),
)
@settings(max_examples=40)
def test_noise_of_a_fast_stream_is_no_motion(rate_hz: float, noise_deg: float, seed: int, speed: float) -> None:
    """A motion up to the limit of the rate under noise, read at any rate: nothing is rejected."""
    random, count = np.random.default_rng(seed), round(min(2.0 * rate_hz, 1500))
    t = np.arange(count) / rate_hz
    angles = 60.0 + 20.0 * np.sin(speed / 20.0 * t) + noise_deg * random.standard_normal(count)
    found = {fault for s in stream(Intake(SENSOR, 0), angles.tolist(), rate_hz) for fault in s.faults}
    assert found <= {"no-angle"}  # of a sample that began just before


@given(rate_hz=st.sampled_from([25.0, 100.0, 1000.0, 5000.0]), speed=st.floats(1300.0, 5000.0))
@settings(max_examples=20)
def test_a_motion_that_is_too_fast_is_found_at_every_rate(rate_hz: float, speed: float) -> None:
    """Small steps of a fast stream add up: 60 deg at three times the limit of the rate."""
    angles = [30.0] * round(rate_hz) + [min(30.0 + speed * k / rate_hz, 90.0) for k in range(round(rate_hz))]
    assert any("jump" in s.faults for s in stream(Intake(SENSOR, 0), angles, rate_hz))


@given(
    outside=st.floats(0.1, 0.8),
    turns_hz=st.floats(0.5, 4.0),
    shows=st.sampled_from([130.0, -5.0, math.nan, 1e308]),
)
@example(outside=0.16, turns_hz=2.0, shows=130.0)  # two samples in turn: no silence is longer than a reading may be old
@settings(max_examples=40)
def test_times_without_an_angle_add_up(outside: float, turns_hz: float, shows: float) -> None:
    """A tip that leaves the range in turns, or a sensor that fails in turns, stops a run before a dead one would."""
    lasts = outside / turns_hz
    angles = [shows if (k / 25.0 * turns_hz) % 1.0 < outside else 60.0 + 0.1 * math.sin(k) for k in range(25 * 22)]
    dead = [s.dead for s in stream(Intake(SENSOR, 0), angles, 25.0)]
    beyond = math.isfinite(shows)
    if lasts >= (0.08 if beyond else 0.2):
        assert any(dead)
        per_s = outside - (0.04 * turns_hz if beyond else 0.0)
        allowed = 1.5 * (0.5 if beyond else 1.0) / max(per_s, 1e-9) + 2.0 / turns_hz  # in whole samples
        assert next(k for k, cause in enumerate(dead) if cause) / 25.0 <= max(allowed, 0.7) + 0.1


@given(share=st.floats(0.0, 0.1), lost=st.floats(0.0, 0.3), seed=st.integers(0, 100))
@settings(max_examples=20)
def test_single_outliers_and_lost_readings_do_not_add_up(share: float, lost: float, seed: int) -> None:
    random, judge = np.random.default_rng(seed), Intake(SENSOR, 0)
    for k in range(1, 1500):
        shown = 140.0 if random.random() < share else 60.0 + 0.1 * math.sin(k)
        come = [Reading(shown, k, 1, k * 40 * MS, k * 40 * MS, math.nan)] if random.random() >= lost else []
        assert judge.judge(come, k * 40 * MS, 0.0).dead == ""


@given(quantum=st.floats(0.05, 3.0), noise=st.floats(0.0, 0.5), play=st.floats(0.0, 2.4), seed=st.integers(0, 100))
@settings(max_examples=30)
def test_a_coarse_sensor_is_not_frozen_and_a_fine_one_is(quantum: float, noise: float, play: float, seed: int) -> None:
    """A quantised angle that stays while the command goes through the play; noise of up to half a quantum."""
    random, judge, tip = np.random.default_rng(seed), Intake(SENSOR, 0), 0.0
    for k in range(1, 660):
        u = 3.0 - 3.0 * math.cos(2.0 * math.pi * max(k - 60, 0) / 300.0)  # after a rest, in which noise may flip it
        tip = min(max(tip, u - 0.5 * play), u + 0.5 * play)
        angle = quantum * round((30.0 + 10.0 * tip + noise * quantum * float(random.standard_normal())) / quantum)
        assert judge.judge([at(k, angle)], PERIOD * (k + 1) * MS, u).dead == ""
    dead = [s.dead for s in frozen_after(30, 0.1)]
    assert any("frozen" in cause for cause in dead)


def test_the_angle_is_shown_also_where_it_is_not_believed() -> None:
    """Where the tip may not go is judged by it: neither range nor rate make an angle missing there."""
    assert begun().judge([at(3, 150.0)], PERIOD * 4 * MS, 0.0).shown_deg == 150.0
    assert begun().judge([at(3, 119.0)], PERIOD * 4 * MS, 0.0).shown_deg == 119.0
    assert math.isnan(begun().judge([at(3, 150.0, late_ms=200.0)], (PERIOD * 4 + 200) * MS, 0.0).shown_deg)
    assert math.isnan(begun().judge([], PERIOD * 4 * MS, 0.0).shown_deg)


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


@pytest.mark.parametrize("held", [math.inf, -math.inf])
def test_what_is_no_number_is_not_held(held: float) -> None:
    intake = Intake(SENSOR, 0)
    assert math.isnan(intake.judge([Reading(40.0, 1, 1, 0, 0, held)], 0, 1.5).held)


def test_what_a_stale_reading_tells_does_not_count() -> None:
    intake = Intake(SensorSettings(lower_deg=0.0, upper_deg=120.0), 0)
    old = 200_000_000
    intake.judge([Reading(40.0, 1, 1, 0, 0, 1.5)], 0, 1.5)
    assert math.isnan(intake.judge([Reading(41.0, 2, 1, 40_000_000, old, 1.5)], old + 40_000_000, 1.5).held)
