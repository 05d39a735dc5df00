"""Intermittent sensors and none at the bench: what counts as a frame, how old it is, and whole runs over real wires."""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.bench.device import make_plant
from hystmpc.ctrl.loop import ImagingSettings
from hystmpc.rig.config import RunSettings
from hystmpc.rig.device import DeviceSettings, SimulatedDevice, open_link
from hystmpc.rig.experiment.experiment import run_experiment
from hystmpc.rig.experiment.phases import Past, PhaseInput, place_frames
from hystmpc.rig.experiment.record import Recorded, RecordSettings, record
from hystmpc.rig.safety.intake import Intake, Observation, ObservedFrame, SensorSettings
from hystmpc.rig.safety.plausibility import MotionWatch, PlausibilitySettings
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.simulated import SimulatedTransport
from hystmpc.rig.transports.transport import Reading
from hystmpc.rig.transports.udp import UdpLink
from hystmpc.trials.errors import ConfigError

from .bench_parts import FakeClock, ListSink
from .test_dds import needs_dds

MS = 1_000_000
NOW = 10_000 * MS
CAMERA: dict[str, Any] = {"kind": "intermittent", "lower_deg": 0, "upper_deg": 120, "latency_s": 0.2}


def frame(k: int, angle: float, sent_ms: float, received_ms: float, held: float = 1.0) -> Reading:
    return Reading(angle, k, 1, round(sent_ms * MS), round(received_ms * MS), held)


def camera(**changes: Any) -> Intake:
    """A judge that has accepted a frame of 30 deg which was under way for no time beyond the latency."""
    judge = Intake(SensorSettings.parse(CAMERA | changes), NOW - 300 * MS)
    (first,) = judge.judge([frame(1, 30.0, 0.0, 10_000.0)], NOW, 1.0).frames
    assert (first.angle_deg, first.age_s) == (30.0, pytest.approx(0.2))
    return judge


@given(st.floats(0.0, 1000.0), st.floats(0.0, 300.0))
def test_a_frame_is_as_old_as_its_latency_its_excess_and_its_wait(excess_ms: float, waited_ms: float) -> None:
    arrived = 10_200.0 + excess_ms
    seen = camera().judge([frame(2, 31.0, 200.0, arrived)], round((arrived + waited_ms) * MS), 1.0)
    age_s = 0.2 + 1e-3 * (excess_ms + waited_ms)
    if abs(age_s - 1.0) > 1e-6:
        assert (seen.faults == ("stale",)) == (age_s > 1.0)
    if not seen.faults:
        assert (seen.angle_deg, seen.age_s) == (31.0, pytest.approx(age_s, abs=1e-3))  # clocks drift apart


def test_between_frames_nothing_is_missing_and_the_device_says_what_it_holds() -> None:
    seen = camera().judge([frame(2, math.nan, 220.0, 10_020.0, held=1.5)], NOW + 20 * MS, 1.5)
    assert (seen.faults, seen.frames, seen.held) == ((), (), 1.5)
    assert math.isnan(seen.angle_deg)
    assert camera().judge([], NOW + 40 * MS, 1.0).faults == ()


def test_a_frame_that_is_shown_again_is_no_new_one() -> None:
    seen = camera().judge([frame(2, 30.0, 0.0, 10_010.0, held=1.5)], NOW + 20 * MS, 1.5)
    assert (seen.frames, seen.faults, seen.held) == ((), (), 1.5)


def test_an_overtaken_frame_is_used_and_is_no_measure_for_the_next() -> None:
    judge = camera()
    assert judge.judge([frame(2, 34.0, 400.0, 10_400.0)], NOW + 400 * MS, 1.0).frames
    seen = judge.judge([frame(3, 32.0, 200.0, 10_440.0)], NOW + 440 * MS, 1.0)
    assert [(f.angle_deg, f.age_s) for f in seen.frames] == [(32.0, pytest.approx(0.44, abs=0.01))]
    assert math.isnan(seen.angle_deg)


@given(st.floats(0.0, 120.0), st.integers(1, 800))
def test_the_rate_counts_the_time_between_two_frames(angle: float, later_ms: int) -> None:
    judge = camera(rate_limit_deg_s=100.0)
    seen = judge.judge([frame(2, angle, later_ms, 10_000 + later_ms)], NOW + later_ms * MS, 1.0)
    if abs(abs(angle - 30.0) - 0.1 * max(later_ms, 20.0)) > 1e-6:
        assert (seen.faults == ("jump",)) == (abs(angle - 30.0) > 0.1 * max(later_ms, 20.0))


def test_repeated_frames_while_the_command_moves_are_a_frozen_sensor() -> None:
    """Of a sensor that has not repeated itself before: 30 frames that differ."""
    judge, faults = camera(frozen_samples=3), []
    for k in range(2, 32):
        judge.judge([frame(k, 30.0 + 0.01 * (k % 3), 200.0 * k, 10_000 + 200.0 * k)], NOW + 200 * k * MS, 0.0)
    for k in range(32, 38):
        shown = frame(k, 30.0, 200.0 * k, 10_000 + 200.0 * k, held=math.nan)
        faults.append(judge.judge([shown], NOW + 200 * k * MS, k).faults)
    assert faults == [(), (), (), ("frozen",), ("frozen",), ("frozen",)]


def test_a_gap_stops_the_run_when_it_is_longer_than_the_longest() -> None:
    judge = camera(longest_gap_s=1.5)
    told = [frame(k, math.nan, 40.0 * k, 10_000 + 40.0 * k) for k in range(2, 60)]
    dead = [judge.judge([one], one.received_ns, 1.0).dead for one in told]
    first = next(k for k, cause in enumerate(dead) if cause)
    assert 1e-9 * (told[first].received_ns - NOW) == pytest.approx(1.3, abs=0.05)
    assert "sensor dead" in dead[first]


@pytest.mark.parametrize(("latency_s", "cause"), [(0.6, ""), (0.0, "implausible")])
def test_motion_is_judged_with_the_command_of_the_moment_at_which_a_frame_was_taken(
    latency_s: float, cause: str
) -> None:
    """Frames 0.6 s late of a device that follows at once; taken for the present they look like a blocked tip."""
    watch = MotionWatch(PlausibilitySettings(travel=1.0, moves_deg=2.0, travel_s=0.05), 6.0, 120.0)
    judge, seen = (
        Intake(SensorSettings.parse(CAMERA | {"latency_s": latency_s}), NOW, watch),
        Observation(math.nan, (), ""),
    )
    for k in range(1, 100):
        t_ms = 40.0 * k
        shown = 30.0 + 20.0 * 1e-3 * max(t_ms - 600.0, 0.0)  # 20 deg/s
        readings = [frame(k, shown, t_ms - 600.0, 10_000 + t_ms, held=math.nan)] if k % 5 == 0 else []
        seen = judge.judge(readings, NOW + round(t_ms * MS), 4.0 * 1e-3 * t_ms)  # 4 mm/s
    assert seen.dead.startswith(cause)
    assert bool(seen.dead) == bool(cause)


def test_without_a_sensor_no_angle_is_missed_and_a_device_that_falls_silent_is() -> None:
    quiet = Intake(SensorSettings(kind="none", rest_deg=30.0), 0)
    seen = quiet.judge([], 100_000 * MS, 1.0)
    assert (seen.faults, seen.dead, math.isnan(seen.angle_deg)) == ((), "", True)
    telling = Intake(SensorSettings(kind="none", rest_deg=30.0), 0)
    seen = telling.judge([frame(1, 1e9, 0.0, 100.0, held=1.0)], 100 * MS, 1.0)
    assert (seen.faults, seen.dead, seen.held) == ((), "", 1.0)
    assert telling.judge([], 600 * MS, 1.0).dead == ""
    assert "device silent" in telling.judge([], 601 * MS, 1.0).dead


any_float = st.floats(allow_nan=True, allow_infinity=True)
times_ms = st.floats(-2000.0, 2000.0)


@pytest.mark.parametrize("block", [CAMERA, {"kind": "none", "rest_deg": 30.0}], ids=lambda block: block["kind"])
@settings(max_examples=60)
@given(st.lists(st.tuples(any_float, times_ms, times_ms, any_float), max_size=20))
def test_whatever_comes_is_judged_and_what_is_believed_is_plausible_and_of_the_past(
    block: dict[str, Any], come: list[tuple[float, float, float, float]]
) -> None:
    judge, sensor = Intake(SensorSettings.parse(block), NOW), SensorSettings.parse(block)
    for k, (angle, sent_ms, received_ms, held) in enumerate(come):
        now = NOW + 40 * k * MS
        reading = frame(k, angle, 10_000.0 + sent_ms, 1e-6 * now - abs(received_ms), held)
        for seen in judge.judge([reading], now, 1.0).frames:
            assert sensor.kind == "intermittent"
            assert 0.0 <= seen.angle_deg <= 120.0
            assert 0.2 - 1e-6 <= seen.age_s <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("block", "text"),
    [
        ({}, "got no lower_deg and no upper_deg"),
        ({"kind": "none"}, "got no rest_deg"),
        ({"kind": "none", "rest_deg": 1e6}, "less than or equal to"),
        ({"lower_deg": 0, "upper_deg": 9, "rest_deg": 3.0}, "expected it for kind none alone"),
        (CAMERA | {"latency_s": 1.0}, "expected latency < oldest frame <= longest gap"),
        (CAMERA | {"longest_gap_s": 0.5}, "expected latency < oldest frame <= longest gap"),
    ],
)
def test_settings_that_make_no_sense_are_refused(block: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        SensorSettings.parse(block)


BENCH: dict[str, Any] = {
    "name": "simulated",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "ramps": {"velocity_per_s": 9, "acceleration_per_s2": 80, "jerk_per_s3": 2000},
    "safe_command": 0,
    "transport": {"kind": "udp", "host": "127.0.0.1", "port": 1},
}
REFERENCE = {"kind": "point_to_point", "start_deg": 35, "targets_deg": [50], "holds_s": [1.0]}
NONE = {"kind": "none", "rest_deg": 29.0}
CHECK = {"step": "pretension_check", "by": 1, "least_move_deg": 3, "most_move_deg": 20}


def run_settings(sensor: dict[str, Any], **more: Any) -> RunSettings:
    tip = {"model": "builtin:tendon-catheter"} | more.pop("controller", {})
    return RunSettings.parse(BENCH | {"sensor": sensor, "controller": tip, "reference": REFERENCE} | more)


def test_the_controller_is_told_and_contradictions_are_refused() -> None:
    estimator = run_settings(CAMERA | {"oldest_frame_s": 0.8}).controller.controller.estimator
    assert (estimator.sensor, estimator.oldest_frame_s) == ("intermittent", 0.8)
    assert run_settings(NONE).controller.controller.estimator.sensor == "none"
    told = run_settings(CAMERA)
    assert RunSettings.parse(told.model_dump(mode="json")) == told
    cases = [
        ({"controller": {"controller": {"kind": "pid"}}}, "expected continuous or intermittent"),
        ({"controller": {"controller": {"kind": "inverse", "estimator": {"sensor": "continuous"}}}}, "expected none"),
        ({"prepare": [CHECK]}, "got prepare step pretension_check with sensor.kind none"),
    ]
    for more, text in cases:
        with pytest.raises(ConfigError, match=text):
            run_settings(NONE, **more)
    ramps = {"steps": {"kind": "ramps", "start": 0, "stops": [1], "holds_s": [1]}}
    with pytest.raises(ConfigError, match="a trial holds angles"):
        RecordSettings.parse(BENCH | {"sensor": NONE, "excitations": ramps})


@pytest.mark.parametrize("sensor", [CAMERA, {"lower_deg": 0, "upper_deg": 120}], ids=["frames", "continuous"])
def test_before_recording_by_frames_it_is_said_that_no_fit_reads_the_trials(
    sensor: dict[str, Any], tmp_path: Path
) -> None:
    """Nobody answers at the port: whatever is said is said before anything moves."""
    ramps, said = {"steps": {"kind": "ramps", "start": 0, "stops": [1], "holds_s": [1]}}, list[str]()
    plain = BENCH | {"sensor": sensor, "excitations": ramps, "connect_timeout_s": 0.05}
    settings = RecordSettings.parse(plain | {"latch_file": str(tmp_path / "latched.json")})
    with pytest.raises(ConfigError, match="got no angle"):
        record(settings, ListSink, make_plant, tmp_path, note=said.append)
    assert [("fit" in line, "\n" in line) for line in said] == [(True, False)] * (sensor is CAMERA)


@settings(max_examples=50)
@given(st.lists(st.integers(0, 14), max_size=8, unique=True), st.randoms())
def test_a_frame_stands_in_the_sample_in_which_it_was_taken(taken: list[int], mixed: Any) -> None:
    """In what a controller is told, and in a trial; a frame from before the beginning shows the rest."""
    arrivals: dict[int, list[int]] = {}
    for k in taken:
        arrivals.setdefault(min(k + mixed.randrange(0, 5), 14), []).append(k)
    past, phase = Past([], []), Recorded("r", np.arange(14.0), 0.04, late=5)
    finished = False
    for now in range(20):
        frames = tuple(ObservedFrame(float(k), 0.04 * (now - k)) for k in arrivals.get(now, []))
        given_now = PhaseInput(math.nan, float(now), frames=frames)
        past.keep(given_now, 0.04)
        finished = phase.step(given_now).finished
    assert {k: y for k, y in enumerate(past.angles_deg) if math.isfinite(y)} == {k: float(k) for k in taken}
    assert finished
    assert {k + 1 for k, y in enumerate(phase.angles_deg) if math.isfinite(y)} == {k for k in taken if k > 0}
    early = [math.nan] * 3
    place_frames(early, (ObservedFrame(29.0, 4.0),), 0.04)
    assert early[0] == 29.0


def ride(folder: Path, link: dict[str, Any], sensor: dict[str, Any], device: dict[str, Any]) -> tuple[Any, ListSink]:
    """A run against a device in a thread of its own, over a real wire; the device's log is its own word."""
    plant = {"simulator": "builtin:tendon-catheter"}
    block = {"rate_hz": 25, "command_unit": "mm", "plant": plant, "limits": BENCH["limits"], "sensor": device}
    served = DeviceSettings.parse(block | {"link": link | ({"bind_port": 0} if link["kind"] == "udp" else {})})
    computed, held = make_plant(served.plant, served.dt_s, 0, folder, "mm")
    wire, flag = open_link(served), StopFlag()
    with (folder / "device.csv").open("w") as log:
        simulated = SimulatedDevice(served, computed, held, wire, log)
        thread = Thread(target=simulated.serve, args=(flag, 60.0), daemon=True)
        thread.start()
        try:
            transport = {"kind": "udp", "port": wire.port} if isinstance(wire, UdpLink) else link
            flexure = [{"step": "flexure", "lower": 0, "upper": 3}]
            latch = {"latch_file": str(folder / "latched.json"), "transport": transport, "prepare": flexure}
            sink = ListSink()
            result = run_experiment(run_settings(sensor, **latch), lambda: sink, lambda *_: (computed, held))
        finally:
            flag.set("over")
            thread.join(5.0)
            wire.close()
    return result, sink


def held_angles(folder: Path) -> list[float]:
    """Angles of the device while it was held at the target, in its own log."""
    with (folder / "device.csv").open() as file:
        rows = [(float(row[3]), float(row[4])) for row in csv.reader(file)]
    return [y for (u, y), (before, _) in zip(rows[1:], rows[:-1], strict=True) if abs(u - before) < 1e-3 and y > 47.0]


DDS = {"kind": "dds", "message": "float64_stamped", "domain": 10 + (os.getpid() + 37) % 90}


@pytest.mark.slow
@pytest.mark.parametrize("link", [{"kind": "udp"}, pytest.param(DDS, marks=needs_dds)], ids=["udp", "dds"])
def test_a_run_by_frames_leads_the_device_to_the_target(link: dict[str, Any], tmp_path: Path) -> None:
    seen = {"kind": "intermittent", "rate_hz": 5, "latency_s": 0.2, "jitter_s": 0.02, "noise_deg": 0.1}
    result, sink = ride(tmp_path, link, CAMERA, seen)
    assert (result.outcome.cause, result.outcome.faults) == ("", {})
    assert result.outcome.confirmed
    ages = [s.t_s - s.taken_s for s in sink.samples if math.isfinite(s.measured_deg)]
    assert 0.1 * len(sink.samples) < len(ages) < 0.35 * len(sink.samples)
    assert 0.15 < min(ages) <= max(ages) < 0.5
    assert np.median(held_angles(tmp_path)) == pytest.approx(50.0, abs=0.5)


@pytest.mark.slow
def test_a_run_without_a_sensor_leads_the_device_to_the_target(tmp_path: Path) -> None:
    result, sink = ride(tmp_path, {"kind": "udp"}, NONE, {"kind": "none"})
    assert (result.outcome.cause, result.outcome.faults) == ("", {})
    assert result.outcome.confirmed
    assert all(math.isnan(s.measured_deg) and math.isnan(s.taken_s) for s in sink.samples)
    assert np.median(held_angles(tmp_path)) == pytest.approx(50.0, abs=0.5)


def test_a_device_in_this_process_shows_frames_as_old_as_its_camera_says() -> None:
    clock, dt = FakeClock(), 0.04
    camera_of = ImagingSettings(rate_hz=5, latency_s=0.2, jitter_s=0.03)
    wire = SimulatedTransport(Steady(), dt, 0.0, clock.now_ns, camera_of, seed=2)
    judge, ages, dead = Intake(SensorSettings.parse(CAMERA), clock.now_ns()), [], ""
    for k in range(500):
        readings = []
        while (reading := wire.read()) is not None:
            readings.append(reading)
        seen = judge.judge(readings, clock.now_ns(), 0.0)
        ages += [(frame.age_s, k * dt - (frame.angle_deg - 30.0)) for frame in seen.frames]
        dead = seen.dead
        wire.write(0.0)
        clock.ns += round(dt * 1e9)
    assert (len(ages) > 90, dead) == (True, "")
    believed, true = np.array(ages[10:]).T
    np.testing.assert_allclose(believed, true, atol=0.1)


class Steady:
    """A plant whose angle is 30 deg plus the seconds since the reset."""

    dt = 0.04

    def __init__(self) -> None:
        self.k = 0

    def reset(self) -> float:
        return 30.0

    def apply(self, u: float) -> float:
        del u
        self.k += 1
        return 30.0 + self.k * self.dt

    def stop(self) -> None:
        pass
