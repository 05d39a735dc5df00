"""Histogram arithmetic, units, the judge of measurements, the latch, settings."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.config import load_run
from hystmpc.rig.device import FaultSettings, FaultyReadings
from hystmpc.rig.experiment.record import load_record
from hystmpc.rig.histogram import BINS, Histogram
from hystmpc.rig.realtime import RealtimeSettings, SchedulingSettings, control_process, scheduled
from hystmpc.rig.safety.gate import Gate
from hystmpc.rig.safety.intake import Intake, SensorSettings
from hystmpc.rig.safety.stop import Latch
from hystmpc.rig.transports.transport import NEW, REPLAYED, RESTARTED, Conversion, Order, Outgoing, Reading, WireUnits
from hystmpc.trials.errors import ConfigError

from ..conftest import ROOT

pytestmark = pytest.mark.slow

MS = 1_000_000
EXAMPLES = ROOT / "examples"


@given(st.lists(st.floats(0, 0.2), min_size=1, max_size=200))
def test_histogram_counts_everything_once_and_bounds_its_quantiles(times: list[float]) -> None:
    histogram = Histogram(0.08)
    for seconds in times:
        histogram.add(seconds)
    summary = histogram.summary()
    assert int(histogram.counts.sum()) == summary.count == len(times)
    assert summary.greatest_s == max(times)
    assert summary.mean_s == pytest.approx(np.mean(times))
    assert summary.median_s <= summary.p99_s <= summary.p999_s <= summary.greatest_s
    exact = sorted(times)[math.ceil(0.5 * len(times)) - 1]
    if exact < 0.08 * (BINS - 1) / BINS:
        assert exact <= summary.median_s + 1e-12 <= exact + 0.08 / BINS + 1e-9


@given(st.floats(allow_nan=True), st.floats(0, 6))
def test_gate_admits_nothing_beyond_its_limits(wanted: float, held: float) -> None:
    gate = Gate(CommandLimits(0.0, 6.0, 10.0), 0.04)
    assert gate.anchor(held)
    u = gate.admissible(wanted, 0)
    assert 0 <= u <= 6
    assert abs(u - held) <= 0.4 + 1e-12
    assert gate.last == held
    gate.sent(u, 0)
    assert gate.last == u


@given(
    st.sampled_from([("mm", "mm"), ("m", "mm"), ("bar", "bar"), ("kPa", "bar"), ("Pa", "bar")]),
    st.sampled_from(["deg", "rad"]),
    st.sampled_from([1, -1]),
    st.floats(-1e3, 1e3),
)
def test_units_go_out_and_come_back(units: tuple[str, str], angle: str, sign: int, value: float) -> None:
    wire = WireUnits.parse({"angle_unit": angle, "angle_sign": sign, "angle_offset_deg": 3.0, "command_unit": units[0]})
    conversion = Conversion.of(wire, units[1])
    assert conversion.angle_deg(conversion.raw_angle(value)) == pytest.approx(value, abs=1e-9)
    assert conversion.command(conversion.raw_command(value)) == pytest.approx(value, abs=1e-9)


def test_units_are_those_of_physics() -> None:
    conversion = Conversion.of(WireUnits(angle_unit="rad", command_unit="kPa"), "bar")
    assert conversion.angle_deg(math.pi) == pytest.approx(180)
    assert conversion.raw_command(2.0) == pytest.approx(200)
    with pytest.raises(ConfigError, match="expected a unit of the run's mm"):
        Conversion.of(WireUnits(command_unit="bar"), "mm")


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 1000), min_size=1, max_size=30))
def test_sequence_numbers_rise_also_over_their_end(start: int, jumps: list[int]) -> None:
    order, sequence = Order(), start
    assert order.judge(1, sequence) == NEW
    for jump in jumps:
        before, sequence = sequence, (sequence + jump) % 2**32
        assert order.judge(1, sequence) == NEW
        assert order.judge(1, sequence) == REPLAYED
        assert order.judge(1, before) == REPLAYED
    assert order.lost == sum(jumps) - len(jumps)
    assert order.judge(2, 0) == RESTARTED
    assert order.judge(1, (sequence + 1) % 2**32) == REPLAYED


def intake() -> Intake:
    return Intake(SensorSettings(lower_deg=0, upper_deg=120, rate_limit_deg_s=400), 0)


def reading(k: int, angle: float, *, sent_ms: float | None = None, received_ms: float | None = None) -> Reading:
    received = 40 * (k + 1) if received_ms is None else received_ms
    sent = received if sent_ms is None else sent_ms
    return Reading(angle, k, 1, round(sent * MS), round(received * MS), 0.0)


def test_a_packet_that_queued_on_the_way_is_stale_without_a_common_clock() -> None:
    judge = intake()
    for k in range(5):  # the sender's clock is hours off; that alone is nothing
        assert judge.judge([reading(k, 30.0 + k, sent_ms=40 * (k + 1) + 9e6)], 40 * (k + 1) * MS, 0.0).faults == ()
    late = reading(5, 35.0, sent_ms=240 + 9e6, received_ms=240 + 150)
    assert judge.judge([late], (240 + 150) * MS, 0.0).faults == ("stale",)


def test_an_old_angle_in_the_queue_is_passed_over_for_the_newest() -> None:
    seen = intake().judge([reading(0, 30.0), reading(1, 31.0), reading(1, 99.0)], 80 * MS, 0.0)
    assert seen.angle_deg == 31.0
    assert seen.faults == ("replayed-or-reordered",)


def test_a_jump_is_rejected_until_it_is_plausible() -> None:
    judge = intake()
    judge.judge([reading(0, 30.0)], 40 * MS, 0.0)
    assert judge.judge([reading(1, 70.0)], 80 * MS, 0.0).faults == ("jump",)  # 1000 deg/s
    assert judge.judge([reading(2, 30.5)], 120 * MS, 0.0).angle_deg == 30.5


def test_a_restarted_device_stops_the_run() -> None:
    judge = intake()
    judge.judge([reading(0, 30.0)], 40 * MS, 0.0)
    other = Reading(30.0, 0, 2, 80 * MS, 80 * MS, 0.0)
    assert "restarted" in judge.judge([other], 80 * MS, 0.0).dead


def test_latch_stays_until_it_is_released(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "deep" / "latched.json")
    latch.require_released()
    latch.set("sensor dead")
    with pytest.raises(ConfigError, match="sensor dead; look at the device, then start with --reset"):
        Latch(latch.file).require_released()
    latch.release()
    latch.require_released()


def test_a_killed_program_leaves_the_latch_set_and_a_living_one_keeps_others_out(tmp_path: Path) -> None:
    """The lock of the system decides who is alive, whatever process number the file holds."""
    latch = Latch(tmp_path / "latched.json")
    holder = (
        "import sys, time; from pathlib import Path; from hystmpc.rig.safety.stop import RUNNING, Latch\n"
        "with Latch(Path(sys.argv[1])).held() as latch:\n"
        "    latch.set(RUNNING); print('held', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", holder, latch.file], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ConfigError, match=f"process {other.pid} controls this device now"), latch.held():
            pass
        assert latch.file.exists()
        other.kill()
    with latch.held(), pytest.raises(ConfigError, match="killed while it controlled"):
        latch.require_released()
    latch.file.write_text("{")
    with pytest.raises(ConfigError, match="unreadable latch"):
        latch.require_released()


def test_realtime_that_is_refused_says_so_and_everything_is_put_back() -> None:
    import gc

    cores = os.sched_getaffinity(0)
    with control_process(RealtimeSettings(cpu=10_000)) as notes:
        assert not gc.isenabled()
    assert gc.isenabled()
    assert len(notes) == 1
    assert "core 10000 refused" in notes[0]
    assert os.sched_getaffinity(0) == cores


def permitted(setting: dict[str, object]) -> None:
    with scheduled(SchedulingSettings.parse(setting)) as notes:
        refused = list(notes)
    if refused:
        pytest.skip(refused[0])


def test_all_threads_that_may_hold_the_interpreter_are_scheduled_like_the_loop_and_put_back() -> None:
    permitted({"priority": 5})
    end, found = threading.Event(), []
    thread = threading.Thread(target=end.wait)
    thread.start()
    assert thread.native_id is not None
    try:
        for _ in range(2):
            with control_process(RealtimeSettings(priority=5)) as notes:
                assert not notes
                found.append(
                    [(os.sched_getscheduler(n), os.sched_getparam(n).sched_priority) for n in (0, thread.native_id)]
                )
            assert os.sched_getscheduler(0) == os.sched_getscheduler(thread.native_id) == os.SCHED_OTHER
    finally:
        end.set()
        thread.join()
    assert found == [[(os.SCHED_FIFO, 5), (os.SCHED_FIFO, 4)]] * 2


def test_locked_memory_is_given_back() -> None:
    permitted({"lock_memory": True})

    def locked_kb() -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmLck")).split()[1])

    with control_process(RealtimeSettings(lock_memory=True)) as notes:
        assert not notes
        assert locked_kb() > 1000
    assert locked_kb() == 0


def out(wire: FaultyReadings, count: int = 50) -> list[Outgoing]:
    arrived = []
    for k in range(count):
        wire.put(Outgoing(float(k), 0.0, k, k * 40 * MS), 0.04 * k)
        arrived += wire.due(0.04 * k)
    return arrived


@pytest.mark.parametrize("name", ["freeze", "nan", "outlier", "dropout", "delay", "jitter", "reorder", "duplicate"])
def test_faults_begin_and_end_when_they_have_to(name: str) -> None:
    fault = FaultSettings.parse({"fault": name, "start_s": 0.8, "duration_s": 0.4})
    arrived = out(FaultyReadings([fault], seed=0))
    clean = [Outgoing(float(k), 0.0, k, k * 40 * MS) for k in range(50)]
    assert arrived[:20] == clean[:20]
    assert arrived[-5:] == clean[-5:]
    assert arrived != clean


def test_examples_are_valid() -> None:
    drill = ["drill.solver_fails_from_s=1", "drill.solver_fails_for_s=2"]
    run = load_run(EXAMPLES / "bench_udp.yaml", ["rate_hz=50", *drill])
    assert run.rate_hz == 50
    assert run.transport.kind == "udp"
    assert len(load_record(EXAMPLES / "bench_record.yaml").excitations) == 2


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("safe_command=7", "safe_command 7.0, expected it within limits 0.0 to 6.0"),
        ("ramps.velocity_per_s=11", "at most limits.rate_per_s"),
        ("transport.host=192.0.2.1", "expected a loopback address, or `allow_network: true`"),
        ("transport.bind_host=0.0.0.0", "expected a loopback address"),
        ("saffe_command=0", "did you mean 'safe_command'"),
        ("sensor.dead_after_s=0.01", "expected at least age_limit_s"),
        ("ramps.brake_per_s2=20", "goes on for v^2 / (2 a) = 2.5, expected at most stop_overshoot 0.12"),
    ],
)
def test_unsafe_settings_are_refused(change: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        load_run(EXAMPLES / "bench_udp.yaml", [change])
