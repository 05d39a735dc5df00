"""Runs on a device of two axes: real datagrams, a simulated device, and whatever may go wrong between them."""

from __future__ import annotations

import importlib.util
import math
import os
import signal
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystmpc.bench.device import plants_in
from hystmpc.rig.axes import each, together
from hystmpc.rig.device import DeviceSettings
from hystmpc.rig.experiment.phases import CommandMotion
from hystmpc.rig.experiment.plane import plane_tracking, run_plane_experiment
from hystmpc.rig.experiment.plane_review import PlaneReview, review_bench_run
from hystmpc.rig.live.desk import Desk
from hystmpc.rig.plane_config import PlaneRunSettings, says_two_axes
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.rig.recording.sample import SampleList
from hystmpc.rig.run import BenchResult, DeviceContact, control_loop, run_bench
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.transport import Reading
from hystmpc.trials.axes import both_axes
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.read import read_trials

from .bench_parts import NS, FakeClock, ListSink
from .plane_bench import LIMITS, RATE_HZ, bench, model_in, require_within_limits, served

DT = 1 / RATE_HZ
SAFE = (0.0, 0.5)


HAS_DDS = importlib.util.find_spec("cyclonedds") is not None
DDS = pytest.param("dds", marks=[pytest.mark.slow, pytest.mark.skipif(not HAS_DDS, reason="cyclonedds (extra rig)")])
of_each_wire = pytest.mark.parametrize("wire", ["udp", DDS])


def run(
    folder: Path,
    faults: Sequence[Mapping[str, Any]] = (),
    desk: Desk | None = None,
    wire: str = "udp",
    **changes: Any,
) -> tuple[BenchResult, SampleList, Any]:
    """A run on the device, its samples, and the device."""
    kept = SampleList()
    with served(folder, faults, wire) as device:
        wanted = bench(folder, 0, **{"transport": device.transport} | changes)
        result = run_plane_experiment(wanted, lambda: kept, plants_in(folder, "mm"), desk=desk)
    return result, kept, device


@of_each_wire
def test_a_run_tracks_the_reference_and_reads_back_as_a_trial(wire: str, tmp_path: Path) -> None:
    """One angle is missing for four samples, which the trial leaves out."""
    folder, nan = tmp_path / "run", {"fault": "nan", "axis": "x", "start_s": 2.6, "duration_s": 4 * DT}
    with served(tmp_path, [nan], wire) as device:
        wanted = bench(tmp_path, 0, transport=device.transport, prepare=[])
        meta = RecordingMeta("mm", stages=("step", "total", "execution"), axes=2)
        result = run_plane_experiment(
            wanted,
            lambda: open_recorder_process(folder, wanted, meta, RATE_HZ, Views(), report=False),
            plants_in(tmp_path, "mm"),
            folder=folder,
        )
    outcome = result.outcome
    assert (outcome.cause, outcome.confirmed) == ("", True)
    assert outcome.faults["x-not-a-number"] >= 1
    assert "y-not-a-number" not in outcome.faults
    require_within_limits(device.tap)
    assert device.counts[0].beyond == 0
    review = review_bench_run(folder)
    assert isinstance(review, PlaneReview)
    assert review.tip_deg < 1.5
    trial = (both_axes(read_trials(folder / "trial.csv")) or [None])[0]
    assert trial is not None
    assert trial.commands.shape == trial.angles.shape == (len(trial.t), 2)
    assert (folder / "report.html").read_text(encoding="utf-8").count("angle y [deg]") >= 1


@dataclass
class Blinking:
    """A plant whose angle of one axis is missing in some samples."""

    plant: Any
    axis: int
    missing: range
    k: int = 0

    @property
    def dt(self) -> float:
        return float(self.plant.dt)

    def reset(self) -> Any:
        return self.plant.reset()

    def apply(self, u: Any) -> Any:
        self.k += 1
        angles = self.plant.apply(u)
        if self.k in self.missing:
            angles[self.axis] = math.nan
        return angles

    def stop(self) -> None: ...


def computed(folder: Path, axis: int, missing: range) -> list[Any]:
    """Samples of a run on a device that is computed, so that two runs are the same but for what is missing."""
    simulated = {"kind": "simulated", "plant": {"simulator": "both.yaml", "noise_deg": 0.05}}
    kept, wanted = SampleList(), bench(folder, 0, transport=simulated, prepare=[])
    phase, frame = plane_tracking(wanted, threaded=False)

    def plants(settings: Any, dt_s: float) -> Any:
        plant, held = plants_in(folder, "mm")(settings, dt_s)
        return Blinking(plant, axis, missing), held

    result = run_bench(wanted, lambda: [phase], lambda: kept, plants, clock=SimulatedClock(), frame=frame)
    assert result.outcome.cause == ""
    return kept.samples


@pytest.mark.parametrize("axis", [0, 1])
def test_a_missing_angle_holds_the_estimate_of_its_axis_and_makes_neither_command_jump(
    axis: int, tmp_path: Path
) -> None:
    """In a sample without an angle both commands stay near those of the same run with it."""
    model_in(tmp_path)
    whole = computed(tmp_path, axis, range(0))
    moves = np.abs(np.diff([each(sample.command) for sample in whole], axis=0))
    begun = next(k for k, sample in enumerate(whole) if sample.source == "mpc")
    first = begun + int(np.argmax(moves[begun:-60].min(axis=1))) - 2  # both commands move
    blind = computed(tmp_path, axis, range(first, first + 4))
    missing = [k for k, sample in enumerate(blind) if f"{'xy'[axis]}-not-a-number" in sample.faults]
    assert len(missing) == 4
    for k in missing:
        assert blind[k].source == "mpc"
        assert math.isfinite(each(blind[k].measured_deg)[1 - axis])
        assert all(map(math.isfinite, each(blind[k].predicted_deg)))
        away = np.abs(np.array(each(blind[k].command)) - each(whole[k].command))
        assert np.all(away <= 0.1 * moves[first - 20 : first + 20].max(axis=0))


@of_each_wire
def test_a_signal_leads_both_commands_to_the_safe_ones_within_their_rates(wire: str, tmp_path: Path) -> None:
    timer = threading.Timer(2.8, os.kill, (os.getpid(), signal.SIGTERM))
    timer.start()
    try:
        result, kept, device = run(tmp_path, wire=wire)
    finally:
        timer.cancel()
    outcome = result.outcome
    assert outcome.cause == "SIGTERM"
    assert outcome.confirmed
    require_within_limits(device.tap)
    stop = np.array([sample.command for sample in kept.samples if sample.source == "stop"])
    assert stop[-1] == pytest.approx(SAFE)
    assert np.all(np.abs(np.diff(stop, axis=0)) <= np.array(LIMITS["rate_per_s"]) * DT * (1 + 1e-9))
    rows = device.rows()
    assert (rows["held_x"][-1], rows["held_y"][-1]) == pytest.approx(SAFE, abs=1e-3)
    with pytest.raises(ConfigError, match="latched"):
        run(tmp_path)


@pytest.mark.parametrize(
    ("axis", "wire"), [("x", "udp"), ("y", "udp"), pytest.param("y", *DDS.values, marks=DDS.marks)]
)
def test_a_dead_sensor_of_one_axis_stops_both(axis: str, wire: str, tmp_path: Path) -> None:
    result, kept, device = run(tmp_path, [{"fault": "nan", "axis": axis, "start_s": 0.6}], wire=wire)
    assert result.outcome.cause.startswith(f"{axis}: sensor dead")
    assert result.outcome.confirmed
    require_within_limits(device.tap)
    assert each(kept.samples[-1].command) == pytest.approx(SAFE)


share = st.floats(0.05, 0.6)
fault = st.fixed_dictionaries(
    {
        "fault": st.sampled_from(["dropout", "delay", "jitter", "reorder", "duplicate", "replay", "corrupt"]),
        "of": st.sampled_from(["readings", "commands"]),
        "start_s": st.floats(0.0, 0.6),
        "share": share,
        "delay_s": st.floats(0.0, 0.3),
    }
)
hostile = st.fixed_dictionaries(
    {
        "fault": st.sampled_from(["nan", "outlier", "out_of_range", "freeze", "blocked", "dislodged"]),
        "axis": st.sampled_from(["x", "y", None]),
        "start_s": st.floats(0.0, 0.6),
        "share": share,
    }
)


@given(st.lists(fault, min_size=1, max_size=3), st.lists(hostile, max_size=2))
@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_wire_and_sensor_do_commands_stay_within_limits(
    tmp_path_factory: pytest.TempPathFactory, wire: list[dict[str, Any]], sensor: list[dict[str, Any]]
) -> None:
    require_laws_of_a_broken_run(tmp_path_factory.mktemp("bench"), [*wire, *sensor], "udp")


@pytest.mark.slow
@pytest.mark.skipif(not HAS_DDS, reason="cyclonedds (extra rig)")
@given(st.lists(hostile, min_size=1, max_size=3))
@settings(max_examples=2, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_the_sensor_does_over_dds_commands_stay_within_limits(
    tmp_path_factory: pytest.TempPathFactory, sensor: list[dict[str, Any]]
) -> None:
    require_laws_of_a_broken_run(tmp_path_factory.mktemp("bench"), sensor, "dds")


def require_laws_of_a_broken_run(folder: Path, faults: list[dict[str, Any]], wire: str) -> None:
    """Commands as they left the controller, and what the device held, lie within value and rate."""
    desk = Desk()
    timer = threading.Timer(1.2, desk.flag.end)
    timer.start()
    try:
        _, _, device = run(folder, faults, desk, wire, prepare=TO_AND_FRO)
    finally:
        timer.cancel()
    require_within_limits(device.tap, slack=0.1)  # after a gap a rate counts from what the device says that it holds
    assert device.counts[0].beyond == 0
    rows = device.rows()
    for axis, name in enumerate(("x", "y")):
        held, rate = rows[f"held_{name}"], LIMITS["rate_per_s"][axis]
        assert np.all(np.abs(held) <= 3.0)
        assert np.all(np.abs(np.diff(held)) <= rate * DT * (1 + 1e-9))


TO_AND_FRO = [{"step": "move", "to": [2.0, -2.0]}, {"step": "move", "to": [-1.0, 2.0]}]
QUICK = {"kind": "points", "points": [[0, 0], [15, -10], [-5, 5]], "hold_s": 0.0}
angle = st.one_of(st.floats(), st.floats(-20, 20), st.just(math.nan))
value = st.one_of(
    st.none(), st.tuples(angle, angle), st.tuples(angle), angle, st.sampled_from([OSError("gone"), ValueError("odd")])
)
told_of = st.sampled_from(["true", "true", "true", "nan", "one", "wild", "number"])


class ScriptedPair:
    """A device whose readings come from a script; it holds what it is sent."""

    def __init__(self, clock: FakeClock, script: list[tuple[Any, str, int]]) -> None:
        self.clock, self.script, self.held, self.sent = clock, script, (0.0, 0.0), list[tuple[int, tuple[float, ...]]]()
        self.k = self.read_ns = 0

    counters: Mapping[str, int] = {}

    def read(self) -> Reading | None:
        if self.clock.ns - self.read_ns < 0.5 * DT * NS:
            return None
        self.read_ns, self.k = self.clock.ns, self.k + 1
        angles, says, late = self.script[self.k % len(self.script)]
        if isinstance(angles, Exception):
            raise angles
        if angles is None:
            return None
        held: Any = {
            "true": self.held, "nan": (math.nan, 0.0), "one": (self.held[0], math.nan), "wild": (99.0, 0.0),
            "number": 1.0,
        }[says]  # fmt: skip
        return Reading(angles, self.k, 1, self.clock.ns - late, self.clock.ns, held)

    def write(self, command: Any) -> None:
        self.held = command
        self.sent.append((self.clock.ns, command))

    def greet(self) -> None: ...

    def stop(self, goodbye: bool = False) -> None: ...

    def numbers(self) -> None: ...

    def take_back(self, unread: Any, sent: int) -> None: ...


@given(st.lists(st.tuples(value, told_of, st.integers(0, 3 * 10**8)), min_size=1, max_size=30))
def test_hostile_readings_move_no_command_beyond_its_limits(
    script: list[tuple[Any, str, int]],
) -> None:
    """The loop, its gate and its anchor, with any readings, on a clock that obeys."""
    wanted = PlaneRunSettings.model_validate(
        {
            "name": "pair",
            "rate_hz": RATE_HZ,
            "command_unit": "mm",
            "limits": LIMITS,
            "safe_command": SAFE,
            "ramps": {"velocity_per_s": 3.0},
            "sensor": {"lower_deg": -60, "upper_deg": 60},
            "transport": {"kind": "udp"},
            "controller": {"model": "both.yaml"},
            "reference": QUICK,
        }
    )
    clock, sink, flag = FakeClock(), ListSink(), StopFlag()
    device = ScriptedPair(clock, script)
    still = together((0.0, 0.0))
    contact = DeviceContact(still, Reading(still, 0, 1, clock.ns, clock.ns, still))

    def way(held: Any) -> Any:
        return waypoint_commands(held, [together((2.0, -2.0)), still], [0.1, 0.1], wanted.ramps, DT)

    loop = control_loop(wanted, device, clock, contact, flag, sink, closed_loop=True)  # type: ignore[arg-type]
    loop.run([CommandMotion("travel", way)])
    last, at = np.zeros(2), None
    for now, command in device.sent:
        u = np.array(command)
        assert np.all((np.array(LIMITS["lower"]) <= u) & (u <= np.array(LIMITS["upper"])))
        elapsed = DT if at is None else min(max(1e-9 * (now - at), 0.1 * DT), DT)
        assert np.all(np.abs(u - last) <= np.array(LIMITS["rate_per_s"]) * elapsed * (1 + 1e-9) + 1e-12)
        last, at = u, now


def test_a_controller_of_one_axis_cannot_move_a_device_of_two(tmp_path: Path) -> None:
    """Its datagrams are of the other version: the device answers none of them."""
    from hystmpc.rig.transports.udp import UdpSettings, UdpTransport

    with served(tmp_path) as device:
        one = UdpTransport(UdpSettings(kind="udp", port=device.port), _one_axis())
        for _ in range(5):
            one.greet()
            one.write(2.0)
            assert one.read() is None
        threading.Event().wait(0.1)
        one.stop()
    assert device.counts[0].commands == 0
    assert device.counts[0].rejected["wrong size"] >= 10


def _one_axis() -> Any:
    from hystmpc.rig.transports.transport import Conversion

    return Conversion(1.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rate_hz": 25.0}, "expected rate_hz 25"),
        ({"command_unit": "bar"}, "expected bar"),
        ({"limits": {"lower": [-9, -3], "upper": [3, 3], "rate_per_s": [8, 4]}}, "beyond_model"),
        (
            {"controller": {"model": "both.yaml", "limits": {**LIMITS, "lower": [-3.5, -3.0]}}},
            "beyond those of the bench",
        ),
    ],
)
def test_a_model_that_does_not_fit_the_bench_is_refused_before_anything_moves(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    file = str(model_in(tmp_path))
    if "controller" in changes:
        changes = {"controller": {**changes["controller"], "model": file}}
    with pytest.raises((ConfigError, ControllerError)) as error:
        plane_tracking(bench(tmp_path, 47001, **changes))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plant_of_one_axis_and_a_transport_of_a_class_are_refused_before_anything_moves(tmp_path: Path) -> None:
    model_in(tmp_path)
    one = {"kind": "simulated", "plant": {"simulator": "builtin:tendon-catheter"}}
    wanted = bench(tmp_path, 0, transport=one, prepare=[], rate_hz=RATE_HZ)
    with pytest.raises(ConfigError, match="a plant of 1 axes, expected 2"):
        run_bench(wanted, list, SampleList, plants_in(tmp_path, "mm"))
    device = ScriptedPair(FakeClock(), [((0.0, 0.0), "true", 0)])
    with pytest.raises(ConfigError, match="for two axes"):
        run_bench(wanted, list, SampleList, plants_in(tmp_path, "mm"), transport=device)  # type: ignore[arg-type]
    assert device.sent == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"faults": [{"fault": "nan", "axis": "y"}]}, "two axes alone"),
        ({"faults": [{"fault": "delay", "axis": "y"}]}, "of a fault of the angle"),
    ],
)
def test_a_fault_of_one_angle_is_refused_where_it_would_do_nothing(changes: dict[str, Any], words: str) -> None:
    plain = {"rate_hz": 25, "command_unit": "mm", "plant": {}, "link": {"kind": "udp"}}
    with pytest.raises(ConfigError, match=words):
        DeviceSettings.parse(plain | {"limits": {"lower": 0, "upper": 6, "rate_per_s": 10}} | changes)


def test_a_file_of_one_axis_is_none_of_two(tmp_path: Path) -> None:
    model_in(tmp_path)
    one = {"limits": {"lower": 0, "upper": 6, "rate_per_s": 10}, "controller": {"model": "builtin:pi"}}
    assert not says_two_axes(one, tmp_path)
    assert not says_two_axes(None, tmp_path)
    assert says_two_axes(one | {"controller": {"model": "both.yaml"}}, tmp_path)
    assert says_two_axes(one | {"limits": {"lower": [0, 0]}}, tmp_path)
    assert says_two_axes({"plant": {"simulator": "both.yaml"}}, tmp_path)
