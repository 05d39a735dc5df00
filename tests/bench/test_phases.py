"""The first motions on an unknown device: never beyond a limit, whatever it answers; short of the angle's limits."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hystmpc.bench.config import narrowed
from hystmpc.bench.device import BenchDevice, DeviceStoppedError, plants_in
from hystmpc.bench.motions import recordings
from hystmpc.bench.phases import Climb, Dash
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.rig.experiment.phases import Past, PhaseInput
from hystmpc.trajectories.scan import SinusoidScan
from hystmpc.trials.errors import ConfigError, LogError

from .small_commission import SCAN, Spied, spied_device, within
from .small_commission import settings as bench_settings

ANGLES = st.one_of(
    st.just(math.nan), st.just(math.inf), st.floats(-1e3, 1e3), st.floats(20.0, 90.0), st.integers(-3, 3).map(float)
)


@given(answers=st.lists(ANGLES, min_size=1, max_size=40), share=st.floats(0.0, 1.0))
@settings(max_examples=25)
def test_whatever_the_device_answers_it_gets_no_command_beyond_a_limit(
    answers: list[float], share: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """NaN, infinite, frozen, jumping angles, from any moment on; it ends at the safe command."""
    folder = tmp_path_factory.mktemp("any")
    bench, sent = bench_settings(folder), list[float]()
    wrong_from = round(60 * share)

    def angle(k: int, u: float, y: float) -> float:
        return answers[k % len(answers)] if k >= wrong_from else y

    device = spied_device(bench, folder, sent, angle)
    climb = Climb(bench, 6.0, (6.0, 114.0), 5)
    try:
        device.explore("1-range/climb", climb, bench)
        device.explore("1-range/dash", Dash(bench, 6.0), bench)
    except (DeviceStoppedError, ConfigError):
        pass
    assert within(sent, bench)
    assert not sent or sent[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
@given(answers=st.lists(ANGLES, min_size=1, max_size=40), share=st.floats(0.0, 1.0), controlled=st.booleans())
@settings(max_examples=12)
def test_recordings_and_tracks_keep_to_the_range_that_was_found(
    answers: list[float], share: float, controlled: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The narrower range and rate hold for what a controller asks for on wrong angles, too."""
    folder = tmp_path_factory.mktemp("narrow")
    whole, sent = bench_settings(folder), list[float]()
    narrow = narrowed(whole, 0.0, 3.0, 4.0)
    wrong_from = round(100 * share)

    def angle(k: int, u: float, y: float) -> float:
        return answers[k % len(answers)] if k >= wrong_from else y

    device = spied_device(whole, folder, sent, angle)
    tip = TipSettings.parse({"model": "builtin:pi", "controller": {"kind": "pid"}})
    try:
        if controlled:
            device.track("7-verify/scan", tip, SinusoidScan.parse(SCAN | {"amplitude_deg": 25.0}), narrow)
        else:
            device.play("2-record/steps", recordings(narrow, 0.1, 1)["steps"], narrow)
    except (DeviceStoppedError, ConfigError, LogError):
        pass
    assert within(sent, narrow)
    assert not sent or sent[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("controlled", [False, True])
def test_a_tip_that_overshoots_beyond_its_limits_stops_the_run(controlled: bool, tmp_path: Path) -> None:
    """The limits that the user gives hold in motion, too; one outlier is no angle."""
    bench, sent = bench_settings(tmp_path, commission={"angle_limits_deg": [20.0, 90.0]}), list[float]()
    commands = recordings(bench, 0.1, 1)["slow_sine"]
    once = spied_device(bench, tmp_path, sent, lambda k, u, y: 100.0 if k == 60 else y)
    assert len(once.play("2-record/slow_sine", commands, bench)) > 0.9 * commands.size
    over = spied_device(bench, tmp_path, sent, lambda k, u, y: y + 12.0 * u)
    tip = TipSettings.parse({"model": "builtin:pi", "controller": {"kind": "inverse"}})
    moves = {
        True: partial(over.track, "7-verify/scan", tip, SinusoidScan.parse(SCAN), bench),
        False: partial(over.play, "2-record/slow_sine", commands, bench),
    }
    with pytest.raises(DeviceStoppedError, match=r"beyond commission\.angle_limits_deg"):
        moves[controlled]()
    assert sent[-1] == pytest.approx(0.0, abs=1e-9)
    assert within(sent, bench)


def test_a_device_that_rests_elsewhere_is_led_to_the_safe_command_first(tmp_path: Path) -> None:
    bench, sent = bench_settings(tmp_path), list[float]()
    plants = plants_in(Path(), "mm")
    device = BenchDevice(
        bench, lambda block, dt_s: (Spied(plants(block, dt_s)[0], sent, lambda k, u, y: y), 2.0), tmp_path
    )
    climb = Climb(bench, 6.0, (6.0, 114.0), 4)
    device.explore("1-range/climb", climb, bench)
    assert sent[0] == pytest.approx(2.0, abs=0.1)
    assert climb.result.end == 6.0
    assert min(sent) == pytest.approx(0.0, abs=1e-9)
    assert sent.index(min(sent)) < sent.index(max(sent))


@given(gain=st.floats(2.0, 40.0), high=st.floats(40.0, 110.0), steps=st.integers(4, 20), bend=st.floats(1.0, 1.1))
@settings(max_examples=15)
def test_the_tip_stays_within_its_limits_and_the_range_is_used(
    gain: float, high: float, steps: int, bend: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Of a tip without lag whose slope grows by less than a half from step to step: it never rests beyond its limit."""
    assume(30.0 + gain * 6.0 / steps / 4 <= high)  # nothing is known of the slope before the first quarter of a step
    folder = tmp_path_factory.mktemp("gain")
    bench = bench_settings(folder, plausibility={"watch_motion": False})
    sent, angles = list[float](), list[float]()

    def angle(k: int, u: float, y: float) -> float:
        angles.append(30.0 + gain * 6.0 * (u / 6.0) ** bend + 1e-6 * (k % 7))
        return min(angles[-1], 119.0)

    climb = Climb(bench, 6.0, (20.0, high), steps)
    spied_device(bench, folder, sent, angle).explore("1-range/climb", climb, bench)
    reached = 30.0 + gain * 6.0 * (climb.result.end / 6.0) ** bend
    assert reached <= high + 1e-3
    assert climb.result.angle_deg == pytest.approx(reached, abs=1e-3)
    assert max(angles) <= high + 1e-3
    if 30.0 + gain * 6.0 <= high - 1.5 * gain * 6.0 / steps:
        assert climb.result.end == 6.0
    assert within(sent, bench)


def test_an_angle_beyond_its_limits_on_the_way_turns_the_climb_back_at_once(tmp_path: Path) -> None:
    """A tip whose slope rises thirtyfold at 2 mm; the step would lead to 3.375 mm, and 112 deg."""
    ramps = {"velocity_per_s": 2, "acceleration_per_s2": 60, "jerk_per_s3": 1000}
    bench, sent = bench_settings(tmp_path, ramps=ramps), list[float]()
    climb = Climb(bench, 6.0, (20.0, 60.0), 4)
    steep = spied_device(
        bench, tmp_path, sent, lambda k, u, y: 30.0 + 2.0 * min(u, 2.0) + 60.0 * max(u - 2.0, 0.0) + 1e-6 * (k % 7)
    )
    steep.explore("1-range/climb", climb, bench)
    assert "the angle reached" in climb.result.why
    assert climb.result.end == pytest.approx(1.875)
    assert 2.43 < max(sent) < 2.9


def test_a_tip_that_saturates_ends_the_climb_before_the_watch_on_motion_stops_it(tmp_path: Path) -> None:
    """It moves up to 3 mm and stays there; the range ends where it was seen to move last, no stop is latched."""
    bench, sent = bench_settings(tmp_path), list[float]()
    climb = Climb(bench, 6.0, (6.0, 114.0), 12)
    flat = spied_device(bench, tmp_path, sent, lambda k, u, y: 30.0 + 10.0 * min(u, 3.0) + 1e-6 * (k % 7))
    flat.explore("1-range/climb", climb, bench)
    assert climb.result.end == pytest.approx(3.0, abs=0.5)
    assert "stayed at 60.00 deg" in climb.result.why
    assert max(sent) <= 3.0 + 0.3 * 6.0


def test_a_tip_that_rests_beyond_limits_that_were_given_is_not_moved(tmp_path: Path) -> None:
    bench, sent = bench_settings(tmp_path), list[float]()
    climb = Climb(bench, 6.0, (40.0, 100.0), 5)
    spied_device(bench, tmp_path, sent).explore("1-range/climb", climb, bench)
    assert set(sent) == {0.0}
    assert "beyond its limits" in climb.result.why
    wide = Climb(bench, 6.0, (40.0, 100.0), 5, widen=True)
    spied_device(bench, tmp_path, sent).explore("1-range/climb", wide, bench)
    assert wide.result.end == 6.0


@pytest.mark.parametrize("own", [12.0, 10.0, 6.0, 4.0])
def test_a_device_slower_than_its_limit_is_found(own: float, tmp_path: Path) -> None:
    """What it tells that it holds moves at a rate of its own, and is a sample late."""
    bench = bench_settings(tmp_path)
    phase, held, told = Dash(bench, 6.0), 0.0, 0.0
    phase.begin(PhaseInput(30.0, 0.0, reported=0.0), Past([], []))
    while True:
        decision = phase.step(PhaseInput(30.0, held, reported=told))
        told += float(np.clip(held - told, -own * bench.dt_s, own * bench.dt_s))
        held = decision.u
        if decision.finished:
            break
    assert phase.tells
    if own >= 10.0:
        assert phase.rate_per_s == 10.0
    else:
        assert 0.6 * own <= phase.rate_per_s <= own


def test_a_device_that_tells_nothing_keeps_the_rate_of_its_limits(tmp_path: Path) -> None:
    bench = bench_settings(tmp_path)
    phase = Dash(bench, 6.0)
    phase.begin(PhaseInput(30.0, 0.0), Past([], []))
    while not phase.step(PhaseInput(30.0, 0.0)).finished:
        pass
    assert (phase.tells, phase.rate_per_s) == (False, 10.0)
