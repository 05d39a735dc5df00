"""Devices of two axes that are dead, exchanged, coupled or interrupted: what a commissioning of them does."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.bench.commission import NAMES
from hystmpc.bench.config import PlaneCommissionSettings, narrowed
from hystmpc.bench.device import BenchDevice, DeviceStoppedError, plants_in
from hystmpc.bench.motions import recordings, shaken
from hystmpc.bench.phases import Bounded, Climb, Dash
from hystmpc.bench.stages import EndedEarlyError, Stages
from hystmpc.rig.recording.recording import RecordingMeta, open_recording
from hystmpc.rig.recording.sample import Sink
from hystmpc.rig.run import reset_latch
from hystmpc.trials.axes import both_axes
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_trials

from ..cli.test_verbs import run
from ..models.two_axis_examples import two_axes
from ..rig.plane_bench import LIMITS, RATE_HZ, require_within_limits, served
from .small_plane import PLANE, Pair, commissioned_plane, plane_settings, require_within, spied_plane, turned


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("watched", [True, False])
def test_a_dead_axis_is_refused_in_one_line(axis: str, watched: bool, tmp_path: Path) -> None:
    """Whether the watch on motion stops the climb or it ends: the line names the axis, both commands go to rest."""
    k, sent = "xy".index(axis), list[Pair]()
    bench = plane_settings(tmp_path, plausibility={"watch_motion": watched, "travel": 1.5})

    def angle(count: int, u: Any, y: Any) -> Any:
        y = np.array(y)
        y[k] = 1e-3 * (count % 7)
        return y

    with pytest.raises((DeviceStoppedError, EndedEarlyError)) as refused:
        commissioned_plane(bench, tmp_path / "run", sent, angle)
    said = str(refused.value)
    assert f"{axis}: implausible" in said if watched else f"range of {axis}: the angle moved by 0" in said
    assert "\n" not in said
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    require_within(sent, bench)
    assert not (tmp_path / "run" / NAMES[0] / "result.json").exists()


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (((1.0, 0.0), (0.0, -1.0)), "range of y: the angle falls as the command rises"),
        (((0.3, 1.0), (1.0, 0.3)), "range of x: the command moved angle y by"),
    ],
)
def test_a_mirrored_axis_and_exchanged_ones_are_refused(
    matrix: tuple[Pair, Pair], expected: str, tmp_path: Path
) -> None:
    bench, sent = plane_settings(tmp_path, two_axes(matrix), plausibility={"watch_motion": False}), list[Pair]()
    with pytest.raises(EndedEarlyError, match=expected):
        commissioned_plane(bench, tmp_path / "run", sent)
    require_within(sent, bench)
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_range_shrinks_until_no_corner_is_beyond_the_limits_of_an_angle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tendons turned by 30 deg: each axis alone stays within, both at once would not; no angle ever is far beyond."""
    limits, sent, seen = (-22.0, 22.0), list[Pair](), list[Any]()
    bench = plane_settings(tmp_path, turned(30.0), commission={"angle_limits_deg": limits})

    def ended(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hystmpc.bench.commission.recordings", ended)
    with pytest.raises(KeyboardInterrupt):
        commissioned_plane(bench, tmp_path / "run", sent, lambda k, u, y: (seen.append(y), y)[1])
    found = (tmp_path / "run" / NAMES[0] / "result.json").read_text()
    assert "both at once reach 100 %" not in found
    assert np.abs(np.array(seen)).max() <= 22.0 + 0.02 * 44.0 + 2.0
    require_within(sent, bench)


def test_a_recording_that_takes_an_angle_beyond_its_limits_stops_both_axes(tmp_path: Path) -> None:
    bench, sent = plane_settings(tmp_path, turned(0.0), commission={"angle_limits_deg": [-15, 15]}), list[Pair]()
    commands = np.column_stack([np.zeros(100), np.linspace(0.0, 3.0, 100)])
    with pytest.raises(DeviceStoppedError, match=r"y: the angle is 1\d\.\d+ deg, beyond commission"):
        spied_plane(bench, tmp_path, sent).play("2-record/far", commands, bench)
    require_within(sent, bench)
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_ctrl_c_in_a_recording_leaves_both_axes_at_the_safe_command_and_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, sent, folder = plane_settings(tmp_path), list[Pair](), tmp_path / "run" / NAMES[1] / "trials"

    def ended(*arguments: Any) -> None:
        raise KeyboardInterrupt

    def first(*arguments: Any) -> dict[str, Any]:
        return dict(list(recordings(*arguments).items())[:3])

    monkeypatch.setattr("hystmpc.bench.commission.check_trials", ended)
    monkeypatch.setattr("hystmpc.bench.commission.recordings", first)

    def angle(count: int, u: Any, y: Any) -> Any:
        if count % 100 == 0 and folder.exists():
            signal.raise_signal(signal.SIGINT)
        return y

    with pytest.raises(DeviceStoppedError, match="SIGINT") as stopped:
        commissioned_plane(bench, tmp_path / "run", sent, angle)
    assert stopped.value.result.outcome.confirmed
    assert sent[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    require_within(sent, bench)
    files = sorted(folder.glob("*.csv"))
    kept = {file: file.read_bytes() for file in files}
    assert kept
    assert len(both_axes(read_trials(files)) or []) == len(files)
    with pytest.raises(ConfigError, match="latched"):
        commissioned_plane(bench, tmp_path / "run", sent)
    reset_latch(bench)
    with pytest.raises(KeyboardInterrupt):
        commissioned_plane(bench, tmp_path / "run", list[Pair]())
    assert {file: file.read_bytes() for file in kept} == kept
    assert (tmp_path / "run" / NAMES[1] / "result.json").exists()


def socket_bench(folder: Path, port: int) -> PlaneCommissionSettings:
    """A bench for the device of `served`."""
    changes: Mapping[str, Any] = {
        "rate_hz": RATE_HZ,
        "limits": LIMITS,
        "safe_command": [0.0, 0.5],
        "ramps": {"velocity_per_s": 4.0, "acceleration_per_s2": 60.0, "jerk_per_s3": 1000.0},
        "transport": {"kind": "udp", "port": port},
    }
    return PlaneCommissionSettings.parse(PLANE | changes | {"latch_file": str(folder / "latch.json")})


@pytest.fixture
def in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is measured is written in a thread: no process is started for each motion. Rests are short."""

    def recorder(folder: Path, config: Any, meta: RecordingMeta, rate_hz: float, *views: object, report: bool) -> Sink:
        return open_recording(folder, config, meta, rate_hz, report=report)

    monkeypatch.setattr("hystmpc.bench.device.open_recorder_process", recorder)
    monkeypatch.setattr("hystmpc.bench.phases.HOLD_S", 0.1)
    monkeypatch.setattr("hystmpc.bench.motions._REST_S", 0.1)
    monkeypatch.setattr("hystmpc.bench.motions._SHAKES", (0.2, -0.1, 0.0))


@pytest.mark.usefixtures("in_a_thread")
def test_over_a_real_socket_climb_and_dash_keep_both_commands_within_their_limits(tmp_path: Path) -> None:
    """The device shares friction, its tendons and its sensor are turned."""
    with served(tmp_path) as it:
        bench = socket_bench(tmp_path, it.port)
        device = BenchDevice(bench, plants_in(tmp_path, "mm"), tmp_path / "run")
        corner = Climb(bench, (1.0, 1.5), bench.angle_limits, 2)  # type: ignore[arg-type]  # both axes
        device.explore("1-range/climb", corner, bench)
        require_within_limits(it.tap)
        it.tap.commands.clear()  # of each run by itself: they are put in order by their numbers
        dash = Dash(bench, (0.0, -1.0))  # type: ignore[arg-type]
        device.explore("1-range/dash", Bounded(dash, None, bench.sensor, 2), bench)
    assert corner.result.end == (1.0, 1.5)
    assert dash.tells
    require_within_limits(it.tap)
    assert it.counts[0].beyond == 0
    assert it.tap.commands[-1].value == pytest.approx((0.0, 0.5), abs=1e-9)


@pytest.mark.usefixtures("in_a_thread")
def test_over_a_real_socket_ctrl_c_keeps_what_is_complete(tmp_path: Path) -> None:
    """In the second recording; both axes end at the safe command, which the device confirms."""
    with served(tmp_path) as it:
        bench = socket_bench(tmp_path, it.port)
        stages = Stages(tmp_path / "run", {}, lambda root, tick: BenchDevice(bench, plants_in(tmp_path, "mm"), root))
        line = np.linspace(0.0, 1.0, 25)
        there = np.array([0.0, 0.5]) + np.column_stack([line, -line])
        runs = {name: np.vstack([there, there[::-1]]) for name in ("first", "second")}
        folder = tmp_path / "run" / NAMES[1]

        def interrupt() -> None:
            while not (folder / "trials" / "first.csv").exists():
                time.sleep(0.02)
            it.tap.commands.clear()
            while len(it.tap.commands) < 0.8 * RATE_HZ:
                time.sleep(0.02)
            signal.raise_signal(signal.SIGINT)

        threading.Thread(target=interrupt, daemon=True).start()
        with pytest.raises(DeviceStoppedError, match="SIGINT") as stopped:
            stages.record(runs, bench, folder)
    assert stopped.value.result.outcome.confirmed
    assert [file.stem for file in (folder / "trials").glob("*.csv")] == ["first"]
    (trial,) = both_axes(read_trials(folder / "trials")) or []
    assert trial.commands.shape == trial.angles.shape
    require_within_limits(it.tap)
    assert it.tap.commands[-1].value == pytest.approx((0.0, 0.5), abs=1e-9)


def test_recordings_keep_to_a_range_that_is_narrower_than_the_limits(tmp_path: Path) -> None:
    """Both axes, also with a safe command that is not in the middle; each begins and ends there."""
    whole = plane_settings(tmp_path, safe_command=[0.5, -1.0])
    bench = narrowed(whole, (-1.0, -2.0), (2.0, 1.5), (5.0, 3.0))  # type: ignore[arg-type]  # both axes
    for commands in (*recordings(bench, 0.1, 1).values(), np.vstack([[0.5, -1.0], shaken(bench)])):
        require_within([tuple(u) for u in commands.tolist()], bench)
        assert commands[0] == pytest.approx((0.5, -1.0))
        assert commands[-1] == pytest.approx((0.5, -1.0))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["commission", "--set", "commission.minutes=11"], "less than or equal to 10"),
        (["commission", "--set", "commission.minutes=2"], "expected more minutes (at most 10)"),
        (
            ["commission", "--set", "safe_command=0"],
            "safe_command: expected a list [x, y], a number",
        ),
    ],
)
def test_what_is_refused_is_one_line(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turned(10.0).save(tmp_path / "both.yaml")
    transport = {"kind": "simulated", "plant": {"simulator": "both.yaml"}}
    bench, (verb, *more) = tmp_path / "bench.yaml", arguments
    bench.write_text(dump_yaml(PLANE | {"transport": transport, "latch_file": "latch.json"}))
    code, _, said = run(capsys, verb, bench, "--out", tmp_path / "run", *more)
    assert code == 2
    assert expected in " ".join(said.split())
    assert not (tmp_path / "run").exists()
