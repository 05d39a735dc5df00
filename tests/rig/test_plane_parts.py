"""Laws of the parts of a bench of two axes: gate, ramps, checks of readings, datagrams, settings."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.two_axes.guarded import TwoAxisCommand
from hystmpc.rig.axes import columns, each, spread, together
from hystmpc.rig.experiment.experiment import decision_of, model_watch
from hystmpc.rig.recording.recorder_process import pack, unpack
from hystmpc.rig.safety.gate import Gate
from hystmpc.rig.safety.intake import Intake, SensorSettings
from hystmpc.rig.safety.plausibility import AxesFrame, PlaneWatch, PlausibilitySettings
from hystmpc.rig.safety.ramp import RampSettings, stop_commands, waypoint_commands
from hystmpc.rig.transports.transport import Conversion, PlaneWireUnits, Reading
from hystmpc.rig.transports.udp import SIZES, Datagram, Kind, decode, encode
from hystmpc.trials.errors import ConfigError

from .plane_bench import bench, model_in
from .recording_samples import sample

NS, DT = 1_000_000_000, 0.04
PAIR = CommandLimits(-3.0, 3.0, 8.0), CommandLimits(-1.0, 2.0, 4.0)
anything = st.one_of(st.floats(), st.tuples(st.floats(), st.floats()), st.tuples(st.floats()), st.just(()))


@given(st.lists(st.tuples(anything, st.integers(0, 10**8)), min_size=1, max_size=40))
def test_the_gate_of_two_axes_admits_only_what_both_limits_allow(steps: list[tuple[Any, int]]) -> None:
    gate, now = Gate(PAIR, DT), 10 * NS
    assert gate.anchor(together((0.5, 1.0)))
    for wanted, later in steps:
        before, now = each(gate.last), now + later
        u = gate.admissible(wanted, now)
        assert len(each(u)) == 2
        for limits, new, old in zip(PAIR, each(u), before, strict=True):
            assert limits.lower <= new <= limits.upper
            assert abs(new - old) <= limits.rate * DT * (1 + 1e-12)
        gate.sent(u, now)


@pytest.mark.parametrize("held", [(0.0, 2.5), (4.0, 0.0), (math.nan, 0.0), 0.0])
def test_the_gate_starts_from_no_place_that_one_axis_may_not_hold(held: Any) -> None:
    gate = Gate(PAIR, DT)
    assert not gate.anchor(held)
    assert not gate.anchored


inside = st.tuples(st.floats(-2.9, 2.9), st.floats(-2.9, 2.9))
speeds = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))


@given(inside, speeds, inside)
def test_a_stop_of_both_axes_arrives_together_within_rate_and_overshoot(
    start: tuple[float, float], speed: tuple[float, float], safe: tuple[float, float]
) -> None:
    ramps, overshoot, fastest = RampSettings(velocity_per_s=3.0), 0.1, 4.0
    commands = stop_commands(together(start), together(speed), together(safe), ramps, overshoot, DT)
    assert commands[-1] == pytest.approx(safe, abs=1e-9)
    low, high = np.minimum(start, safe) - overshoot, np.maximum(start, safe) + overshoot
    assert np.all((low - 1e-9 <= commands) & (commands <= high + 1e-9))
    steps = np.abs(np.diff(np.vstack([start, commands]), axis=0))
    assert np.all(steps <= fastest * DT * (1 + 1e-6))
    if np.all(np.abs(np.array(start) - safe) > 0.05):
        arrives = [int(np.flatnonzero(np.abs(commands[:, i] - safe[i]) > 1e-6)[-1]) for i in range(2)]
        assert abs(arrives[0] - arrives[1]) <= 2


def test_ramps_through_points_rest_at_each_of_them() -> None:
    commands = waypoint_commands(
        together((0.0, 0.0)), [together((2.0, 0.0)), together((2.0, -1.0))], [0.4, 0.4], RampSettings(), DT
    )
    assert commands[-1] == pytest.approx((2.0, -1.0))
    assert np.any(np.all(np.abs(commands - (2.0, 0.0)) < 1e-9, axis=1))
    moved = commands[:, 0] < 2.0 - 1e-9
    assert np.all(commands[moved, 1] == 0.0)


def reading(k: int, angles: tuple[float, float], held: tuple[float, float] = (0.0, 0.0)) -> Reading:
    at = 10 * NS + round(k * DT * NS)
    return Reading(together(angles), k, 1, at, at, together(held))


SENSOR = SensorSettings(lower_deg=-60.0, upper_deg=60.0)


def test_a_missing_angle_of_one_axis_leaves_the_other_one_as_it_is() -> None:
    intake, still = Intake(SENSOR, 10 * NS, None, 2), together((0.0, 0.0))
    intake.judge([reading(0, (1.0, 2.0))], 10 * NS, still)
    seen = intake.judge([reading(1, (math.nan, 2.1))], 10 * NS + round(DT * NS), still)
    x, y = each(seen.angle_deg)
    assert math.isnan(x)
    assert y == 2.1
    assert seen.faults == ("x-not-a-number",)
    assert seen.dead == ""


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("bad", [math.nan, 1e4, math.inf])
def test_a_dead_sensor_of_one_axis_stops_the_run(axis: int, bad: float) -> None:
    intake, still, dead = Intake(SENSOR, 10 * NS, None, 2), together((0.0, 0.0)), ""
    for k in range(40):
        angles = [1.0 + 0.01 * math.sin(k), 2.0 + 0.01 * math.cos(k)]
        if k > 5:
            angles[axis] = bad
        dead = intake.judge([reading(k, (angles[0], angles[1]))], 10 * NS + round(k * DT * NS), still).dead
        assert not (dead and DT * (k - 5) <= SENSOR.dead_after_s - 2 * DT)
    assert dead.startswith(f"{'xy'[axis]}: sensor ")


def test_a_frozen_angle_of_one_axis_is_seen_whichever_command_moves() -> None:
    random = np.random.default_rng(1)
    intake, faults = Intake(SENSOR.model_copy(update={"frozen_samples": 5}), 10 * NS, None, 2), set[str]()
    for k in range(60):
        x = 1.0 + 0.1 * random.standard_normal() if k < 30 else 1.0
        u = together((0.0, 0.05 * k))
        seen = intake.judge([reading(k, (x, random.standard_normal()), each(u))], 10 * NS + round(k * DT * NS), u)
        faults |= set(seen.faults)
    assert "x-frozen" in faults
    assert "y-frozen" not in faults


def test_the_motion_is_watched_in_the_coordinates_of_the_axes() -> None:
    """A tendon at 90 deg moves the other angle: no fault there, and a blocked tip of the axis is one."""
    settings = PlausibilitySettings(travel=1.0, moves_deg=1.0, travel_s=0.1)
    turned = AxesFrame(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2), (6.0, 6.0))
    for frame, blocked in ((turned, False), (AxesFrame(np.eye(2), np.eye(2), (6.0, 6.0)), True)):
        watch, cause = PlaneWatch(settings, frame, 120.0, closed_loop=True), ""
        for k in range(100):
            u = together((0.0, 0.03 * k))  # command y, which moves angle x
            cause = cause or watch.judge(together((0.3 * k, 0.0)), u, 10 * NS + round(k * DT * NS))
        assert bool(cause) is blocked
        assert not blocked or cause.startswith("y: implausible")


pairs = st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)).map(together)
MESSAGES = st.builds(
    Datagram,
    kind=st.sampled_from(list(Kind)),
    session=st.integers(0, 2**32 - 1),
    sequence=st.integers(0, 2**32 - 1),
    stamp_ns=st.integers(0, 2**64 - 1),
    value=pairs,
    held=pairs,
)


@given(MESSAGES)
def test_a_datagram_of_two_axes_goes_out_and_comes_back_and_is_none_of_one_axis(message: Datagram) -> None:
    data = encode(message)
    assert len(data) == SIZES[2] == 60
    assert decode(data, 2) == message
    assert decode(data) == "wrong size"


@given(MESSAGES, st.integers(0, SIZES[2] * 8 - 1))
def test_one_wrong_bit_of_it_is_seen(message: Datagram, bit: int) -> None:
    data = bytearray(encode(message))
    data[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(data), 2) == "wrong checksum"


@given(st.one_of(st.binary(max_size=100), st.binary(min_size=56, max_size=56)))
def test_rubbish_is_read_without_a_crash(body: bytes) -> None:
    message = decode(body + struct.pack("<I", zlib.crc32(body)), 2)
    assert isinstance(message, str) or body[:5] == b"HMPC\x02"


def test_a_datagram_of_one_axis_is_none_of_two() -> None:
    assert decode(encode(Datagram(Kind.COMMAND, 1, 2, 3, 1.5)), 2) == "wrong size"


def test_each_angle_has_its_sign_and_its_offset() -> None:
    wire = PlaneWireUnits.model_validate({"angle_sign": (1, -1), "angle_offset_deg": (0.0, 5.0), "command_unit": "m"})
    conversion = Conversion.of(wire, "mm", 2)
    assert conversion.angle_deg(together((2.0, 3.0))) == (2.0, 2.0)
    assert conversion.raw_angle(together((2.0, 2.0))) == (2.0, 3.0)
    assert conversion.raw_command(together((2.0, -1.0))) == pytest.approx((0.002, -0.001))


def test_samples_of_two_axes_have_their_columns_and_cross_a_pipe() -> None:
    one = sample(3, command=together((1.0, 2.0)), measured_deg=together((math.inf, 5.0)), predicted_deg=math.nan)
    motion = one.motion("command_bar")
    assert motion["command_x_bar"] == 1.0
    assert motion["angle_y_deg"] == 5.0
    assert math.isnan(motion["predicted_x_deg"])
    import io

    assert repr(next(iter(unpack(io.BytesIO(pack([one])))))) == repr([one])
    assert list(columns("command", 0.0, 2)) == ["command_x", "command_y"]
    assert all(map(math.isnan, spread(1.0, 2)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"safe_command": [0.0, 9.0]}, "safe_command 9.0"),
        ({"safe_command": 0.0}, "safe_command"),
        ({"limits": {"lower": [-3, 3], "upper": [3, -3], "rate_per_s": [8, 8]}}, "of y"),
        ({"limits": {"lower": -3, "upper": 3, "rate_per_s": 8}}, "limits.lower"),
        ({"ramps": {"velocity_per_s": 5.0}}, "rate_per_s 4.0"),
        ({"sensor": {"kind": "none", "rest_deg": 0}}, "continuous"),
        ({"transport": {"kind": "replay", "run": "runs"}}, "expected udp, dds, simulated for two axes"),
        ({"realtime": {"backend": "c"}}, "expected python"),
        ({"transport": {"kind": "simulated", "plant": {}, "sensor": {"kind": "none"}}}, "transport.sensor none"),
        ({"prepare": [{"step": "move", "to": [9.0, 0.0]}]}, "move to 9.0"),
        ({"prepare": [{"step": "flexure", "lower": 0, "upper": 1}]}, "flexure"),
        ({"reference": {"kind": "sinusoid_scan"}}, "reference"),
    ],
)
def test_settings_that_do_not_fit_two_axes_are_refused_in_one_line(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    model_in(tmp_path)
    with pytest.raises(ConfigError) as error:
        bench(tmp_path, 47001, **changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) <= 300


@pytest.mark.parametrize("disturbance", [(math.nan, 200.0), (200.0, math.nan), (3.0, -200.0)])
def test_a_model_error_of_one_axis_stops_whatever_is_known_of_the_other(disturbance: tuple[float, float]) -> None:
    watch = model_watch(PlausibilitySettings(), LinearisedMpcSettings(), 0.04)
    command: Any = TwoAxisCommand(np.zeros(2), disturbance=np.array(disturbance))
    causes = [decision_of(command, together((0.0, 0.0)), watch).fault for _ in range(500)]
    assert "off its model" in causes[-1]
