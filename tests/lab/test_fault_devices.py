"""Hostile devices: they do what they say, the judge finds what is planted, and the movers meet a few of them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from hystmpc.bench import phases
from hystmpc.bench.device import plants_in
from hystmpc.cli.main import app
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.safety.gate import Anchor, Gate
from hystmpc.rig.safety.plausibility import MotionWatch
from hystmpc.rig.transports.transport import Conversion, Reading, RunContext
from hystmpc.rig.transports.udp import UdpSettings
from hystmpc_lab.faults.description import Body, DeviceFault, DeviceSpec, FaultKind, Row
from hystmpc_lab.faults.devices import DeviceCase, DevicePlay, device_cases, device_plays, played, played_all
from hystmpc_lab.faults.hostile import HostileDevice, served
from hystmpc_lab.faults.movers import How
from hystmpc_lab.faults.truth import MOVERS, Asked, DeviceVerdict, Ending, Mover, judged

pytestmark = pytest.mark.slow  # seconds together

NS = 1_000_000_000
ASKED = Asked("record", 0.0, 6.0, 10.0, 0.04, 0.12, (0.0, 120.0))
BOUNDED = replace(ASKED, mover="commission", angle_limits_deg=(10.0, 110.0))
SILENT = (DeviceFault("silent", 0.0),)
STOPPED = Ending("stopped", "why", latched=True)


def test_the_catalogue_is_as_large_as_it_says_and_the_same_at_every_call() -> None:
    cases = device_cases()
    assert sum(not case.healthy for case in cases) >= 40
    assert sum(case.healthy for case in cases) >= 20
    names = [case.name for case in cases]
    assert len(set(names)) == len(names)
    assert [case.device for case in device_cases()] == [case.device for case in cases]
    assert {fault.kind for case in cases for fault in case.device.faults} == set(get_args(FaultKind))
    assert not any(case.device.faults for case in cases if case.healthy)


def test_every_mover_meets_most_devices_and_every_law_some() -> None:
    plays = device_plays(device_cases())
    assert all(sum(play.mover == mover for play in plays) >= 60 for mover in MOVERS)
    run = [play.how for play in plays if play.mover == "run"]
    assert {(how.law, how.backend) for how in run} == {
        ("linearised_mpc", "python"),
        ("linearised_mpc", "c"),
        ("pid", "python"),
        ("inverse", "python"),
    }


@settings(max_examples=20, deadline=None)
@given(
    looks=st.lists(st.floats(0.001, 0.2), min_size=5, max_size=40),
    lag_s=st.floats(0.0, 0.5),
    backlash_mm=st.floats(0.0, 2.4),
    creep=st.floats(0.0, 0.2),
)
def test_what_a_device_does_does_not_depend_on_when_it_is_looked_at(
    looks: list[float], lag_s: float, backlash_mm: float, creep: float
) -> None:
    """It is computed between the looks; the watchdog is quiet for half a second after a command."""
    spec = DeviceSpec("one", Body(lag_s=lag_s, backlash_mm=backlash_mm, creep=creep), noise_deg=0.0, watchdog_s=1e9)
    often, once = HostileDevice(spec), HostileDevice(spec)
    for device in (often, once):
        device.connect(SimulatedClock()).greet()
        device.take(3.0)
    for look in looks:
        often.advance(often.state.ns + round(look * NS))
    once.advance(often.state.ns)
    assert often.state.body.angle_deg == pytest.approx(once.state.body.angle_deg, abs=0.05)


def test_its_watchdog_leads_it_back_and_then_it_wants_a_greeting() -> None:
    device = HostileDevice(DeviceSpec("one"))
    wire = device.connect(SimulatedClock())
    device.take(1.0)
    assert device.state.target == 0.0  # nobody has greeted
    wire.greet()
    device.take(1.0)
    device.settle(0.45)
    assert device.state.target == 1.0
    device.settle(1.0)
    assert device.state.target == 0.0
    device.take(1.0)
    assert device.state.target == 0.0
    wire.greet()
    device.take(1.0)
    assert device.state.target == 1.0


def test_calls_that_take_time_make_the_clock_pass() -> None:
    clock = SimulatedClock()
    faults = (DeviceFault("reads_slowly", 0.0, size=0.05), DeviceFault("writes_slowly", 0.0, size=0.02))
    wire = HostileDevice(DeviceSpec("one", faults=faults)).connect(clock)
    wire.greet()
    wire.write(0.0)
    begin = clock.now_ns()
    assert wire.read() is not None
    assert wire.read() is not None
    assert clock.now_ns() - begin == 0.1 * NS
    wire.write(0.0)
    assert clock.now_ns() - begin == pytest.approx(0.12 * NS)


@pytest.mark.parametrize(("size", "hz"), [(0.01, 25.0), (0.2, 1000.0)])
def test_readings_come_later_and_later(size: float, hz: float) -> None:
    clock = SimulatedClock()
    device = HostileDevice(DeviceSpec("one", stream_hz=hz, faults=(DeviceFault("ages", 0.0, size=size),)))
    wire = device.connect(clock)
    device.take(0.0)
    ages = []
    for _ in range(100):
        clock.wait_until(clock.now_ns() + NS // 10)
        while (reading := wire.read()) is not None:
            ages.append(1e-9 * (device.state.ns - reading.sent_ns))
    assert ages[-1] == pytest.approx(10.0 * size / (1.0 + size), abs=0.1)


def log(
    held: Sequence[float], angles: Sequence[float] | None = None, spec: DeviceSpec = DeviceSpec("one"), dt: float = 0.04
) -> HostileDevice:
    """A device that has got and held these commands, one in `dt`, and was then at rest at the last one."""
    device = HostileDevice(spec)
    values = list(angles or [30.0] * len(held))
    before = 0.0
    for k, (u, angle) in enumerate(zip(held, values, strict=True)):
        device.rows.append(Row(1.0 + dt * k, 0, u, before, u, u, u, angle, angle, 0.0))
        before = u
    device.rows.append(replace(device.rows[-1], t_s=device.rows[-1].t_s + 5.0, motion=-1, received=math.nan))
    device.state.ns = round(device.rows[-1].t_s * NS)
    device.state.began_ns = [round((1.0 + fault.at_s) * NS) for fault in spec.faults]
    return device


UP = [0.1 * k for k in range(20)]
DOWN = [1.9 - 0.1 * k for k in range(1, 20)]


def test_a_way_up_and_down_is_as_it_has_to_be() -> None:
    verdict = judged("one", log(UP + DOWN), ASKED, Ending("ended"), healthy=True)
    assert verdict.failures == ()
    assert verdict.commands == 39


@pytest.mark.parametrize(
    ("held", "count"),
    [
        ([*UP, 2.5, *DOWN], 2),  # a jump and one back
        ([*UP, 2.3, *UP[::-1]], 0),  # exactly the rate
        ([0.0, 0.4, 0.5, 0.1, 0.0, -0.1, 0.0], 1),
        ([0.3 * k for k in range(22)] + [6.0 - 0.3 * k for k in range(21)], 1),
    ],
)
def test_commands_beyond_limits_or_rate_are_found(held: list[float], count: int) -> None:
    assert judged("one", log(held), ASKED, STOPPED, healthy=False).beyond == count


def test_a_command_far_from_what_a_watchdog_has_left_is_found() -> None:
    device = log(UP)
    device.rows += [
        replace(device.rows[-1], t_s=10.0, motion=0, received=1.9, before=0.0),
        replace(device.rows[-1], t_s=12.0, received=math.nan, held=0.0),
    ]
    assert judged("one", device, ASKED, STOPPED, healthy=False).beyond == 1


def test_a_pause_earns_no_jump() -> None:
    assert judged("one", log([0.0, 0.0, 0.8, 0.4, 0.0], dt=1.0), ASKED, STOPPED, healthy=False).beyond == 1


def test_motion_away_from_safe_long_after_a_fault_is_found() -> None:
    slow = [0.02 * k for k in range(100)]
    down = slow[::-1]
    device = log(slow + down, spec=DeviceSpec("one", faults=SILENT))
    assert "moved on for 3.9" in " ".join(judged("one", device, ASKED, STOPPED, healthy=False).failures)
    early = log(slow[:30] + slow[:30][::-1], spec=DeviceSpec("one", faults=SILENT))
    assert judged("one", early, ASKED, STOPPED, healthy=False).failures == ()


@pytest.mark.parametrize(
    ("ending", "failure"),
    [
        (Ending("stopped", "why", latched=False), "stopped, and not latched"),
        (Ending("stopped", "", latched=True), "stopped without a cause"),
        (Ending("raised", "TypeError: x"), "raised: TypeError: x"),
        (Ending("ended"), "not stopped, 3.2 s long"),
    ],
)
def test_an_end_that_is_none_is_found(ending: Ending, failure: str) -> None:
    held = UP[:10] + [0.9] * 60 + UP[:10][::-1]
    device = log(held, spec=DeviceSpec("one", faults=SILENT))
    assert judged("one", device, ASKED, ending, healthy=False).failures == (failure,)


def test_a_healthy_device_that_is_stopped_or_left_away_from_rest_is_found() -> None:
    stopped = judged("one", log(UP + DOWN), ASKED, STOPPED, healthy=True)
    assert stopped.failures == ("healthy, but stopped: why",)
    assert judged("one", log(UP), ASKED, STOPPED, healthy=False).failures == ("left at 1.90 mm",)


def test_nothing_sent_shows_nothing() -> None:
    device = log([0.0])
    device.rows[:] = [replace(row, received=math.nan) for row in device.rows]
    verdict = judged("one", device, ASKED, Ending("refused", "no"), healthy=False)
    assert verdict.failures == ("nothing was sent: no",)


@pytest.mark.parametrize(("top", "fails"), [(111.9, False), (113.2, False), (118.0, True)])
def test_a_tip_far_beyond_its_angle_limits_is_found(top: float, fails: bool) -> None:
    """The overshoot is allowed, at the slope of the device, and what its command goes on for three samples: nothing."""
    angles = [30.0] * 15 + [105.0, 112.5, top, top, 60.0] + [30.0] * 19
    device = log([*UP[:15], *([1.4] * 5), *DOWN[5:], *([0.0] * 5)], [*angles])
    verdict = judged("one", device, BOUNDED, STOPPED, healthy=False)
    assert (verdict.past_deg > 0) == fails


def play(mover: Mover, spec: DeviceSpec, folder: Path, healthy: bool = False, **how: Any) -> DeviceVerdict:
    """One play with a PID."""
    made = DevicePlay(DeviceCase(spec, healthy), mover, How(law="pid", **how))
    return played(made, folder / "play")


HEALTHY = DeviceSpec("healthy", seed=3)
QUIET = DeviceSpec("silent", faults=(DeviceFault("silent", 2.0),), seed=4)
REBOOTED = DeviceSpec("restarts", faults=(DeviceFault("restarts", 3.0),), seed=5)
BLOCKED = DeviceSpec("stuck", faults=(DeviceFault("stuck", 2.0),), seed=6)


@pytest.mark.parametrize("mover", MOVERS)
def test_a_healthy_device_goes_on(mover: Mover, tmp_path: Path) -> None:
    verdict = play(mover, HEALTHY, tmp_path, healthy=True)
    assert verdict.failures == ()
    assert verdict.commands > 300


@pytest.mark.parametrize("spec", [QUIET, REBOOTED], ids=lambda spec: spec.name)
@pytest.mark.parametrize("mover", MOVERS)
def test_hostile_devices_are_stopped_in_time(mover: Mover, spec: DeviceSpec, tmp_path: Path) -> None:
    verdict = play(mover, spec, tmp_path)
    assert verdict.failures == ()
    assert verdict.how == "stopped"
    assert math.isfinite(verdict.shows_s)


def test_an_anchor_that_is_never_lost_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program stands still while the device goes back to rest; the next command is far from there."""
    monkeypatch.setattr(Anchor, "judge", lambda self, seen, boot_ns: True)
    monkeypatch.setattr(Anchor, "in_time", lambda self, boot_ns: True)
    monkeypatch.setattr(Gate, "anchored", True, raising=False)
    first = Gate.__init__

    def anchored(self: Gate, *args: Any) -> None:
        first(self, *args)
        self.anchor(0.0)

    monkeypatch.setattr(Gate, "__init__", anchored)
    monkeypatch.setattr(HostileDevice, "due", _always_listens(HostileDevice.due))
    monkeypatch.setattr(HostileDevice, "take", _never_deaf(HostileDevice.take))
    spec = DeviceSpec("stalls", faults=(DeviceFault("stalls", 2.5, size=3.0),))
    assert play("record", spec, tmp_path).beyond > 0


def _always_listens(due: Any) -> Any:
    def listening(self: HostileDevice) -> Any:
        found = due(self)
        return None if found is None else replace(found, listens=True)

    return listening


def _never_deaf(take: Any) -> Any:
    def taken(self: HostileDevice, command: float) -> None:
        self.state.deaf = False
        take(self, command)

    return taken


def test_a_gate_without_a_rate_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Gate, "admissible", lambda self, wanted, now_ns: wanted + 0.5 * (wanted > 2.0))
    assert play("record", HEALTHY, tmp_path, healthy=True).beyond > 0


def test_a_watch_that_sees_nothing_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MotionWatch, "judge", lambda self, *args: "")
    assert "not stopped" in " ".join(play("record", BLOCKED, tmp_path).failures)


def test_angle_limits_that_nobody_looks_at_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phases.Bounded, "step", lambda self, now: self._phase.step(now))
    spec = DeviceSpec("steeper", faults=(DeviceFault("steepens", 0.0, 2, size=3.0),))
    verdict = play("commission", spec, tmp_path, bench={"sensor": {"upper_deg": 400.0}})
    assert verdict.past_deg > 0


@pytest.mark.slow
def test_several_processes_find_the_same(tmp_path: Path) -> None:
    plays = [DevicePlay(DeviceCase(spec), "record", How()) for spec in (QUIET, REBOOTED)]
    one, two = (tuple(played_all(plays, tmp_path / str(jobs), jobs)) for jobs in (1, 2))
    assert [v.words for v in one] == [v.words for v in two]
    assert all(math.isclose(a.shows_s, b.shows_s) for a, b in zip(one, two, strict=True))


@pytest.mark.slow
def test_a_device_in_a_process_of_its_own_keeps_what_it_got_over_udp() -> None:
    device = HostileDevice(HEALTHY)
    with served(device) as port:
        made = UdpSettings(kind="udp", port=port)
        wire = made.open(RunContext(Conversion(1.0, 0.0, 1.0), 0.04, time.monotonic_ns, plants_in(Path(), "mm")))
        readings: list[Reading] = []
        until = time.monotonic() + 30.0
        while len(readings) < 20 and time.monotonic() < until:
            found = wire.read()
            readings += [] if found is None else [found]
            if len(readings) == 5 and not device.rows:
                wire.write(0.2)
        wire.stop()
    assert [row.received for row in device.rows if math.isfinite(row.received)][:1] == [0.2]
    assert readings[-1].held in (0.0, 0.2)
    device.settle(2.0)
    assert device.rows[-1].held == 0.0


def test_the_verb_shows_a_table_and_what_failed(tmp_path: Path) -> None:
    arguments = ["faults", "--devices", "--mover", "record", "--only", "silent", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "0 not as they have to be" in done.output
    assert len(list((tmp_path / "out").glob("*/device.csv"))) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--devices", "--mover", "walk"], "walk"),
        (["--devices", "--only", "no such device"], "no such device"),
        (["--devices", "--transport", "udp"], "--transport"),
        (["--mover", "run"], "--devices"),
    ],
)
def test_a_call_that_makes_no_sense_is_refused(arguments: list[str], said: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["faults", "--out", str(tmp_path / "out"), *arguments])
    assert done.exit_code != 0
    assert said in str(done.exception)


def test_rows_of_the_log_are_in_order(tmp_path: Path) -> None:
    device = HostileDevice(HEALTHY)
    device.connect(SimulatedClock()).greet()
    device.take(1.0)
    device.settle(1.0)
    assert all(a.t_s <= b.t_s for a, b in pairwise(device.rows))
