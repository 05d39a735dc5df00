"""Measured inputs at a bench: on the wire, where they are lost, in the controller, in logs and trials."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.bench.device import make_plant, plants_in
from hystmpc.models.evaluate import evaluate
from hystmpc.models.simulator import ChainModel, save_simulator
from hystmpc.rig.axes import from_the_first, together
from hystmpc.rig.config import RunSettings
from hystmpc.rig.device import DeviceSettings, SimulatedDevice, open_link
from hystmpc.rig.experiment.experiment import run_experiment, tracking_phase
from hystmpc.rig.experiment.record import RecordSettings, record
from hystmpc.rig.experiment.review import review_run
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.recording.recording import RecordingMeta, open_recording
from hystmpc.rig.recording.sample import SampleList
from hystmpc.rig.run import run_bench
from hystmpc.rig.safety.intake import Intake, SensorSettings
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.transport import Reading
from hystmpc.rig.transports.udp import Datagram, Kind, UdpLink, decode, encode
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_trials

from ..ctrl.test_inputs import CHAIN
from ..models.zoo import DT, simulator

NS = 1_000_000_000
SCAN = {
    "kind": "scan_sinusoid", "start_deg": 40, "centre_deg": 55, "amplitude_deg": 12, "frequency_hz": 0.35, "cycles": 4
}  # fmt: skip
MPC = {"kind": "linearised_mpc", "adaptation": None}
finite = st.floats(allow_nan=False, allow_infinity=False)


@given(st.sampled_from([1, 2]), st.lists(finite, max_size=6), finite, st.integers(0, 6))
def test_a_reading_crosses_the_wire_with_its_inputs_and_no_other_end_takes_it(
    axes: int, inputs: list[float], angle: float, other: int
) -> None:
    value = together([angle] * axes)
    sent = Datagram(Kind.READING, 7, 8, 9, value, value, tuple(inputs))
    assert decode(encode(sent), axes, len(inputs)) == sent
    if other != len(inputs):
        assert decode(encode(sent), axes, other) == "wrong size"
    command = Datagram(Kind.COMMAND, 7, 8, 9, value, value)
    assert decode(encode(command), axes, other) == command
    if inputs:
        spoilt = Datagram(Kind.COMMAND, 7, 8, 9, value, value, tuple(inputs))
        assert decode(encode(spoilt), axes, len(inputs)) == "wrong size"


def test_a_lost_value_is_a_fault_and_the_last_one_holds() -> None:
    intake = Intake(SensorSettings(lower_deg=0, upper_deg=120), 0, inputs=("bar",))
    given_ = [{"bar": 2.0}, {}, {"bar": math.nan}, {"bar": "much"}, {"bar": 3.0, "other": 1.0}, None]
    seen = []
    for k, inputs in enumerate(given_):
        now = round(k * DT * NS)
        readings = [] if inputs is None else [Reading(40.0 + 0.1 * k, k, 1, now, now, 1.0, inputs=inputs)]
        seen.append(intake.judge(readings, now, 1.0))
    assert [dict(one.inputs) for one in seen] == [{"bar": 2.0}] * 4 + [{"bar": 3.0}] * 2
    assert ["no-bar" in one.faults for one in seen] == [False, True, True, True, False, True]


def test_a_value_that_comes_late_costs_no_recording_its_input() -> None:
    np.testing.assert_array_equal(from_the_first(np.array([math.nan, math.nan, 2.0, 3.0])), [2.0, 2.0, 2.0, 3.0])
    assert from_the_first(np.full(3, math.nan)).size == 0


def pressure(folder: Path) -> Path:
    """A log of a pressure that rises from 2 to 4 bar, and the device's file."""
    t = np.arange(0.0, 20.0, 0.1)
    rows = np.column_stack([t, 0 * t, 40 + 0 * t, np.interp(t, [1.0, 5.0], [2.0, 4.0])])
    np.savetxt(folder / "bar.csv", rows, delimiter=",", header="time_s,command,angle_deg,bar", comments="")
    return save_simulator(simulator(CHAIN), folder / "device.yaml")


def bench(folder: Path, transport: dict[str, Any], **more: Any) -> RunSettings:
    """A run on the device of `pressure`, along a sine."""
    plain: dict[str, Any] = {
        "name": "inputs",
        "rate_hz": 1 / DT,
        "command_unit": "mm",
        "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
        "safe_command": 0,
        "sensor": {"lower_deg": 0, "upper_deg": 130},
        "transport": transport,
        "latch_file": str(folder / "latched.json"),
        "controller": {"model": str(folder / "device.yaml"), "controller": MPC},
        "reference": SCAN,
        "inputs": ["bar"],
    }  # fmt: skip
    return RunSettings.parse(plain | more)


PLANT = {"simulator": "device.yaml", "inputs": {"bar": {"log": "bar.csv"}}, "noise_deg": 0.02}


def computed(folder: Path, **more: Any) -> tuple[SampleList, float]:
    """Samples of a run in simulated time, and its error while it tracks [deg]."""
    wanted, kept, notes = bench(folder, {"kind": "simulated", "plant": PLANT}, **more), SampleList(), list[str]()
    phase = tracking_phase(wanted, threaded=False, note=notes.append)
    assert any("takes bar 2 as identified" in note for note in notes) == ("bar" not in wanted.inputs)
    result = run_bench(wanted, lambda: [phase], lambda: kept, plants_in(folder, "mm"), clock=SimulatedClock())
    assert result.outcome.cause == ""
    tracked = [s for s in kept.samples if s.source == "mpc"][80:]
    errors = [b.measured_deg - a.reference_deg for a, b in pairwise(tracked)]
    return kept, float(np.sqrt(np.mean(np.square(errors))))


def test_a_controller_that_is_told_the_pressure_tracks_better(tmp_path: Path) -> None:
    """Its samples have the value that the device had when it was measured."""
    pressure(tmp_path)
    kept, known = computed(tmp_path)
    _, unknown = computed(tmp_path, inputs=[])
    assert known < 0.7 * unknown
    got = np.array([s.inputs["bar"] for s in kept.samples])
    assert got[0] == 2.0
    assert got[-1] == 4.0
    assert np.all(np.diff(got) >= 0)


def test_over_a_socket_log_and_trial_have_the_pressure(tmp_path: Path) -> None:
    pressure(tmp_path)
    device = DeviceSettings.parse(
        {
            "rate_hz": 1 / DT, "command_unit": "mm", "plant": PLANT, "inputs": ["bar"],
            "limits": {"lower": 0, "upper": 6, "rate_per_s": 10}, "link": {"kind": "udp", "bind_port": 0},
        }
    )  # fmt: skip
    link, flag = open_link(device), StopFlag()
    assert isinstance(link, UdpLink)
    plant, held = make_plant(device.plant, device.dt_s, 1, tmp_path, "mm")
    thread = threading.Thread(target=SimulatedDevice(device, plant, held, link).serve, args=(flag,))
    thread.start()
    try:
        folder = tmp_path / "run"
        wanted = bench(tmp_path, {"kind": "udp", "port": link.port}, reference=SCAN | {"cycles": 1})
        meta = RecordingMeta("mm", stages=("step", "total", "execution"), inputs=wanted.inputs)
        result = run_experiment(
            wanted,
            lambda: open_recording(folder, wanted, meta, wanted.rate_hz, report=False),
            plants_in(tmp_path, "mm"),
            folder=folder,
        )
    finally:
        flag.set("end")
        thread.join()
        link.close()
    assert (result.outcome.cause, result.outcome.confirmed) == ("", True)
    review = review_run(folder)
    (trial,) = read_trials(folder / "trial.csv", rate_hz=1 / DT)
    bar = trial.with_inputs(["bar"]).inputs["bar"]
    assert 2.0 <= bar.min() < 3.0 < bar.max() <= 4.0
    model = ChainModel(simulator(CHAIN))
    without = evaluate(model, replace(trial.with_inputs(["bar"]), inputs={"bar": np.full(len(trial), 2.0)}))
    assert review.free_run_deg < 0.5 * without.errors.rmse_deg  # the review's free run has the pressure


def test_recorded_trials_have_the_pressure(tmp_path: Path) -> None:
    pressure(tmp_path)
    limits = {"lower": 0, "upper": 6, "rate_per_s": 10}
    plain = bench(tmp_path, {"kind": "simulated", "plant": PLANT}).model_dump() | {"limits": limits}
    keys = set(RecordSettings.model_fields)
    ramps = {"it": {"kind": "ramps", "start": 0, "stops": [3, 0], "holds_s": [0.5, 0.5]}}
    settings = RecordSettings.parse({k: v for k, v in plain.items() if k in keys} | {"excitations": ramps})
    record(settings, SampleList, plants_in(tmp_path, "mm"), tmp_path / "rec")
    (trial,) = read_trials(tmp_path / "rec" / "trials" / "it.csv")
    assert trial.with_inputs(["bar"]).inputs["bar"].min() >= 2.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": ["time_s"]}, "begins as no other column"),
        ({"inputs": ["bar", "bar"]}, "each input once"),
        ({"inputs": ["bar"], "realtime": {"backend": "c"}}, "realtime.backend c"),
        ({"inputs": ["bar"], "transport": {"kind": "replay", "run": "x"}}, "got inputs with transport replay"),
    ],
)
def test_inputs_that_cannot_come_are_refused_in_one_line(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    pressure(tmp_path)
    with pytest.raises(ConfigError, match=words) as refused:
        bench(tmp_path, **({"transport": {"kind": "simulated", "plant": PLANT}} | change))
    assert len(str(refused.value)) <= 300


def test_a_device_without_that_input_is_refused_in_one_line(tmp_path: Path) -> None:
    pressure(tmp_path)
    with pytest.raises(ConfigError, match="the device has no input 'baar'"):
        computed(tmp_path, inputs=["baar"])
