"""FMUs are valid, repeat the Python simulator, and keep the laws of co-simulation."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.codegen import export_fmu
from hystmpc.codegen.fmu import FmuVersion
from hystmpc.models.chain import Chain, operators
from hystmpc.models.load import library_file
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.scheduled import Scheduled
from hystmpc.models.simulator import Simulator, load_simulator
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim import Effects, SimulatedPlant
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ExportError

from ..ctrl.test_two_axes import TENDONS
from ..models.two_axis_examples import COUPLED, SHARED, two_axes
from ..models.zoo import CHAINS, EXAMPLES, WITH_EFFECTS, simulator
from .compiled import EXAMPLES as FILES
from .compiled import STRICT, compile_c, compilers, tried

fmpy = pytest.importorskip("fmpy", reason="fmpy is a tool of development")

from fmpy.validation import validate_fmu  # noqa: E402

from .importer import (  # noqa: E402
    COMMAND,
    TIME,
    VERSIONS,
    Device,
    InPlane,
    Instance,
    by_fmpy,
    by_python,
    exported,
    greatest_difference,
    motions,
    names,
    written,
)

_SHIPPED = {name: load_simulator(library_file(name)) for name in ("tendon-catheter", "pi", "backlash", "auto")}
_EFFECTS = Effects(
    lag_s=0.08,
    delay_s=0.07,
    noise_deg=0.2,
    effects=(
        {"effect": "creep", "side": "command", "parameters": {"share": 0.1, "tau_s": 4.0}},
        {"effect": "stick_slip", "parameters": {"break_away": 0.2, "stribeck_speed": 4.0}},
        {"effect": "periodic_disturbance", "parameters": {"frequency_hz": 1.1, "amplitude": 0.4}},
        {"effect": "drift", "parameters": {"offset_per_min": 1.0}},
    ),
)
PLANTS: Mapping[str, tuple[Simulator, Mapping[str, Any]]] = {
    **{name: (found, {}) for name, found in _SHIPPED.items()},
    "lag, delay, creep, stick-slip, hum, drift": (_SHIPPED["tendon-catheter"], {"effects": _EFFECTS}),
    "never bent": (simulator(WITH_EFFECTS), {"effects": Effects(virgin=True)}),
    "at 100 Hz": (_SHIPPED["auto"], {"effects": Effects(delay_s=0.033), "dt_s": 0.01}),
    **{name: (simulator(chain), {}) for name, chain in CHAINS.items()},
    # One of each operator: the engine runs it, whose other forms are compared in tests/models/test_backends.py.
    **{
        example.name: (simulator(Chain(example)), {})
        for example in {type(example): example for example in EXAMPLES if not isinstance(example, Sensor)}.values()
    },
}
_MIX, _FRAME = ((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0))
_STUDY = {
    "lag_s": 0.03,
    "delay_s": 0.07,
    "noise_deg": 0.1,
    "x": {"mismatch": {"prandtl_ishlinskii.a0": 1.2}},
    "y": {"effects": [{"effect": "creep", "parameters": {"share": 0.1, "tau_s": 4.0}}]},
}
PLANES: Mapping[str, tuple[TwoAxisModel, Mapping[str, Any]]] = {
    "two axes apart": (two_axes(), {}),
    "two axes, turned": (two_axes(_MIX, _FRAME, SHARED), {"lag_s": 0.05}),
    "two axes, turned, coupled, late": (two_axes(_MIX, _FRAME, COUPLED), _STUDY),
    "four tendons": (TENDONS, {}),
    "four tendons behind a lag that share friction": (
        two_axes(cross=SHARED).with_tendons(
            [0, 90, 180, 270], pretension=1.0, limits=[(0.2, 4.0)] * 4, rates_per_s=[8.0] * 4
        ),
        {"lag_s": 0.05, "virgin": True},
    ),
}
"""Devices of two axes: model, and what a study changes of it."""
BOTH = ("auto", "two axes, turned")
"""One device of one axis and one of two, which keep the same laws of co-simulation."""
FAST = ("auto", "lag, delay, creep, stick-slip, hum, drift", "two axes, turned, coupled, late")
# The step of a device is the same text in either version: both for two devices, every other one in one of the two.
cases = [
    *(pytest.param(name, version) for name in FAST for version in VERSIONS),
    *(
        pytest.param(name, VERSIONS[k % 2], marks=pytest.mark.slow)
        for k, name in enumerate(name for name in (*PLANTS, *PLANES) if name not in FAST)
    ),
]
versions = pytest.mark.parametrize("version", VERSIONS)
sources_of = pytest.mark.parametrize("name", [*FAST[1:], "four tendons"])
DT = 0.04


@cache
def plant_of(name: str) -> SimulatedPlant:
    """One of `PLANTS`, made when it is asked for."""
    found, told = PLANTS[name]
    return SimulatedPlant(found, **told)


def device_of(name: str) -> Device:
    """One of `PLANTS` or of `PLANES`."""
    if name in PLANTS:
        return plant_of(name)
    model, changes = PLANES[name]
    return InPlane(model, TwoAxisPlantSettings.parse({"simulator": "model", **changes}))


@pytest.fixture(
    scope="module",
    params=[(name, version) for name in BOTH for version in VERSIONS],
    ids=lambda one: f"{one[0]}-{one[1]}",
)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An unpacked FMU of each version, of the catheter with a lag, and of a device of two axes."""
    name, version = request.param
    place = tmp_path_factory.mktemp("fmu")
    fmu = written(device_of(name), place / "device.fmu", version)
    return Path(fmpy.extract(str(fmu), str(place / "unpacked")))


def started(folder: Path, start_s: float = 0.0, stop_s: float | None = None) -> Instance:
    made = Instance(folder)
    made.start(start_s, stop_s)
    return made


def test_every_operator_is_tried() -> None:
    tried_ones = {type(operator) for found, _ in PLANTS.values() for operator in found.chain.operators}
    assert tried_ones == {*operators().values(), Scheduled} - {Sensor}


@pytest.mark.parametrize(("name", "version"), cases)
def test_it_repeats_the_python_simulator(name: str, version: FmuVersion, tmp_path: Path) -> None:
    plant = device_of(name)
    fmu = written(plant, tmp_path / "device.fmu", version)
    assert validate_fmu(str(fmu)) == []
    assert greatest_difference(fmu, plant) <= 1e-9  # not-a-number is not


@versions
def test_measured_inputs_are_further_variables(version: FmuVersion, tmp_path: Path) -> None:
    """They act in the sample in which they are set; their ranges and starts are described."""
    chain = CHAINS["pi by two inputs"]
    along = {"pressure_bar": lambda t: 3.0 + 3.5 * np.sin(0.9 * t), "load_g": lambda t: 60.0 * np.abs(np.sin(0.4 * t))}
    plant = SimulatedPlant(simulator(chain), inputs=along)
    fmu = written(plant, tmp_path / "device.fmu", version)
    assert validate_fmu(str(fmu)) == []
    assert sorted(names(fmu, "input")) == sorted(["command", *along])
    for commands in motions(plant):
        t = plant.dt * np.arange(len(commands))
        known = {name: f(t) for name, f in along.items()}
        off = np.abs(by_fmpy(fmu, commands, plant.dt, known) - by_python(plant, commands))
        assert off.max() <= 1e-9
    one = started(Path(fmpy.extract(str(fmu), str(tmp_path / "unpacked"))))
    place = one.outputs[-1] + 1
    one.set(place, 4.5)
    assert one.get(place) == 4.5
    with pytest.raises(Exception, match=r"[Ss]et"):
        one.set(place, np.nan)
    assert one.get(place) == 4.5
    assert "measured input" in one.lines[-1]


@pytest.mark.slow
@versions
def test_equal_simulators_give_equal_files(version: FmuVersion, tmp_path: Path) -> None:
    one, two = (written(plant_of("pi"), tmp_path / name, version).read_bytes() for name in ("one.fmu", "two.fmu"))
    other = written(plant_of("backlash"), tmp_path / "other.fmu", version).read_bytes()
    assert one == two != other


@given(
    before=st.lists(st.floats(0.0, 6.0), max_size=20),
    after=st.lists(st.floats(0.0, 6.0), min_size=1, max_size=20),
    between=st.lists(st.floats(0.0, 6.0), max_size=20),
)
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_restored_state_gives_the_same_outputs(
    folder: Path, before: list[float], after: list[float], between: list[float]
) -> None:
    one, other = started(folder), started(folder)
    one.run(np.array(before), DT)
    state, raw = one.save(), one.packed()
    first = one.run(np.array(after), DT)
    one.run(np.array(between), DT)
    one.restore(state)
    assert one.get(TIME) == pytest.approx(DT * len(before))
    np.testing.assert_array_equal(one.run(np.array(after), DT), first)
    other.unpack(raw)
    np.testing.assert_array_equal(other.run(np.array(after), DT), first)


def test_a_state_of_another_device_is_refused(folder: Path) -> None:
    made = started(folder)
    raw = made.packed()
    foreign = bytes([raw[0] ^ 1, *raw[1:]])
    for wrong in (foreign, raw[:-1]):
        with pytest.raises(Exception, match=r"(?i)deserialize"):
            made.unpack(wrong)
    assert made.lines == ["deserialise: these are not the bytes of a state of this FMU"] * 2


def test_instances_are_independent(folder: Path) -> None:
    rise, rest = np.linspace(0.0, 6.0, 50), np.zeros(50)
    alone = started(folder).run(rise, DT)
    one, other = started(folder), started(folder)
    beside = []
    for u, v in zip(rise, rest, strict=True):
        beside.append(one.run(np.array([u]), DT)[0])
        other.run(np.array([v]), DT)
    np.testing.assert_array_equal(beside, alone)
    np.testing.assert_array_equal(other.shown(), started(folder).run(rest, DT)[-1])


def test_a_reset_brings_the_start_back(folder: Path) -> None:
    made = started(folder)
    commands = np.linspace(0.0, 6.0, 50)
    first = made.run(commands, DT)
    made.reset()
    made.start()
    np.testing.assert_array_equal(made.run(commands, DT), first)


@pytest.mark.parametrize("wrong", [0.0, -DT, 0.5 * DT, 1.01 * DT, 0.03, np.nan, np.inf])
def test_a_wrong_step_is_refused_and_changes_nothing(folder: Path, wrong: float) -> None:
    made, other = started(folder), started(folder)
    made.ask(3.0)
    with pytest.raises(Exception, match="DoStep"):
        made.step(0.0, wrong)
    (line,) = made.lines
    assert line == f"step: got {wrong:.9g} s, expected a whole multiple of the sample time 0.04 s"
    commands = np.full(5, 3.0)
    np.testing.assert_array_equal(made.run(commands, DT), other.run(commands, DT))


@pytest.mark.parametrize("length", [1e300, -1e300, 1.7e308, 1e9, 10_000_001 * DT])
def test_a_step_that_would_last_for_ever_is_an_error_at_once(folder: Path, length: float) -> None:
    made, other = started(folder), started(folder)
    with pytest.raises(Exception, match="DoStep"):
        made.step(0.0, length)
    (line,) = made.lines
    assert line.startswith(f"step: got {length:.9g} s, expected ")
    commands = np.full(5, 3.0)
    np.testing.assert_array_equal(made.run(commands, DT), other.run(commands, DT))


ODD = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -0.0, -DT, 5e-324, 1e-300, 1e9, 1e300, 1.7e308, 0.5 * DT])


@given(calls=st.lists(st.tuples(ODD | st.just(DT), ODD | st.just(0.0), ODD | st.floats(0.0, 6.0)), max_size=15))
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_step_is_taken_or_refused_in_a_line_and_the_angle_stays_finite(
    folder: Path, calls: list[tuple[float, float, float]]
) -> None:
    """Lengths, starts and commands of any kind; what is refused changes nothing."""
    made = started(folder)
    for length, later, command in calls:
        before, told = (made.get(TIME), made.shown()), len(made.lines)
        try:
            made.ask(command)
            made.step(made.get(TIME) + later, length)
        except Exception:  # noqa: BLE001 - as fmpy raises
            assert (made.get(TIME), made.shown()) == before
            assert len(made.lines) == told + 1
        else:
            assert np.isfinite(command)
            assert abs(later) <= 0.5 * DT
            assert made.get(TIME) == pytest.approx(before[0] + DT)
            assert len(made.lines) == told
        assert np.isfinite(made.shown()).all()
    made.ask(3.0)
    assert np.isfinite(made.run(np.full(3, 3.0), DT)).all()


def test_a_device_that_overflows_is_an_error_and_keeps_its_state(folder: Path) -> None:
    made, other = started(folder), started(folder)
    made.ask(1.7e308)
    with pytest.raises(Exception, match="DoStep"):
        made.step(0.0, 3 * DT)
    assert made.lines == ["step: the device does not answer this command with finite numbers"]
    commands = np.full(5, 3.0)
    np.testing.assert_array_equal(made.run(commands, DT), other.run(commands, DT))


@pytest.mark.parametrize(
    ("start", "stop", "line"),
    [
        (np.nan, None, "the start time is no number, or too large to count samples from"),
        (1e300, None, "the start time is no number, or too large to count samples from"),
        (0.0, np.nan, "the stop time is no number, or before the start"),
        (5.0, 1.0, "the stop time is no number, or before the start"),
    ],
)
def test_a_run_that_has_no_time_is_refused(folder: Path, start: float, stop: float | None, line: str) -> None:
    made = Instance(folder)
    with pytest.raises(Exception, match=r"SetupExperiment|EnterInitializationMode"):
        made.start(start, stop)
    assert made.lines == [line]


def test_bytes_that_count_too_many_samples_end_in_a_line(folder: Path) -> None:
    """The state behind the token ends with the number of samples and the stage."""
    made = started(folder)
    raw = made.packed()
    made.unpack(raw[:-16] + (2**63 - 1).to_bytes(8, "little") + raw[-8:])
    with pytest.raises(Exception, match="DoStep"):
        made.step(made.get(TIME), DT)
    assert made.lines[-1].startswith(f"step: got {DT:.9g} s, expected at most 10000000 samples")


@versions
@pytest.mark.parametrize("compiler", compilers(), ids=lambda command: Path(command[-1]).name)
def test_sources_are_not_compiled_for_finite_numbers_only(
    version: FmuVersion, compiler: list[str], tmp_path: Path
) -> None:
    plant = plant_of("pi")
    for path, content in export_fmu(plant.simulator, plant.rest, version=version, platforms=()).files.items():
        (tmp_path / Path(path).name).write_bytes(content)
    for options in ("-ffast-math", "-ffinite-math-only"):
        said = tried([*compiler, "-std=c99", options, "-c", "fmu.c", "-o", "made.o"], tmp_path)
        assert "which voids every check for not-a-number: leave out -ffast-math" in said


@given(parts=st.lists(st.integers(1, 5), min_size=1, max_size=10), start=st.floats(-100.0, 1e4))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_step_of_many_samples_is_as_many_steps(folder: Path, parts: list[int], start: float) -> None:
    long, short = started(folder, start), started(folder, start)
    for k, count in enumerate(parts):
        u = np.array([6.0 * (k % 3) / 2])
        once = long.run(u, count * DT)[-1]
        np.testing.assert_array_equal(short.run(np.repeat(u, count), DT)[-1], once)
    assert long.get(TIME) == short.get(TIME) == pytest.approx(start + DT * sum(parts))


def test_what_is_out_of_order_is_refused_in_a_line(folder: Path) -> None:
    made = Instance(folder)
    with pytest.raises(Exception, match="DoStep"):
        made.step(0.0, DT)
    made.start(0.0, 1.0)
    for at, length in ((0.5, DT), (0.0, 26 * DT)):
        with pytest.raises(Exception, match="DoStep"):
            made.step(at, length)
    for which, value in ((made.outputs[0], 1.0), (COMMAND, np.nan), (99, 1.0), (TIME, 1.0)):
        with pytest.raises(Exception, match="Set"):
            made.set(which, value)
    with pytest.raises(Exception, match="Get"):
        made.get(99)
    one = len(made.commands) == 1
    only = "set: only value reference 1, the command, can be set"
    only = only if one else "set: only value references 1 to 2, the commands, can be set"
    known = "0 (time), 1 (command) or 2 (output)" if one else "one of modelDescription.xml"
    assert made.lines == [
        "step: the instance is not initialised, or is terminated",
        "step: got time 0.5 s, expected 0 s, where the last step ended",
        "step: got an end at 1.04 s, beyond the stop time 1 s",
        only,
        f"set: {'the' if one else 'a'} command is not a finite number",
        only,
        only,
        f"get: unknown value reference, expected {known}",
    ]


@versions
def test_variables_of_two_axes_have_the_names_of_the_log(version: FmuVersion, tmp_path: Path) -> None:
    """Of more than two commands they are numbered; limits and start are those of each command."""
    for name, commands in (
        ("two axes apart", ["command_x", "command_y"]),
        ("four tendons", [f"command[{k}]" for k in (1, 2, 3, 4)]),
    ):
        fmu = written(device_of(name), tmp_path / f"{name}.fmu", version)
        assert names(fmu, "input") == commands
        assert names(fmu, "output") == ["angle_x_deg", "angle_y_deg"]
    described = fmpy.read_model_description(str(fmu)).modelVariables
    assert {(one.min, one.max, float(one.start)) for one in described if one.causality == "input"} == {
        ("0.2", "4.0", 1.0)
    }
    assert {one.unit for one in described} == {"s", "mm", "deg"}


def test_the_command_writes_a_model_and_a_study_of_two_axes(tmp_path: Path) -> None:
    """The study with the changes of its plant; what an FMU cannot hold is named."""
    model, changes = PLANES["two axes, turned, coupled, late"]
    model.save(tmp_path / "both.yaml")
    study = {
        "plant": {"simulator": "both.yaml", **changes},
        "model": "both.yaml",
        "motions": {"star": {"kind": "star", "centre": [0, 0], "radius": 12}},
        "controllers": {"mpc": {"kind": "linearised_mpc"}},
    }
    (tmp_path / "study.yaml").write_text(dump_yaml(study), encoding="utf-8")
    for source, said in (("both", "of <math.h>"), ("study", "left out: noise of 0.1 deg")):
        done = CliRunner().invoke(
            app, ["export-fmu", str(tmp_path / f"{source}.yaml"), "--out", str(tmp_path / f"{source}.fmu")]
        )
        assert done.exit_code == 0, done.output
        words = " ".join(done.output.split())
        assert (
            "FMI 2.0, co-simulation, a step every 0.04 s, command_x, command_y [mm] to angle_x_deg, angle_y_deg [deg]"
            in words
        )
        assert words.endswith(said)
    assert greatest_difference(tmp_path / "both.fmu", InPlane(model, TwoAxisPlantSettings(simulator="model"))) <= 1e-9
    assert greatest_difference(tmp_path / "study.fmu", device_of("two axes, turned, coupled, late")) <= 1e-9


@versions
def test_units_are_those_of_the_simulator(version: FmuVersion, tmp_path: Path) -> None:
    described = fmpy.read_model_description(str(written(plant_of("tendon-catheter"), tmp_path / "d.fmu", version)))
    units = {variable.name: variable.unit for variable in described.modelVariables}
    base = {unit.name: (unit.baseUnit.factor, unit.baseUnit.m, unit.baseUnit.rad) for unit in described.unitDefinitions}
    assert units == {"time": "s", "command": "mm", "angle": "deg"}
    assert base == {"s": (1.0, 0, 0), "mm": (1e-3, 1, 0), "deg": (pytest.approx(np.pi / 180), 0, 1)}
    assert float(described.defaultExperiment.stepSize) == DT


@pytest.mark.slow
@versions
@sources_of
def test_the_sources_compile_without_a_warning(name: str, version: FmuVersion, tmp_path: Path) -> None:
    """By every compiler; clang finds fault with a declaration in a header of the standard."""
    with zipfile.ZipFile(written(device_of(name), tmp_path / "d.fmu", version)) as archive:
        archive.extractall(tmp_path)
    flags = [*STRICT, "-Wno-strict-prototypes", "-O2", "-c", "fmu.c"]
    said = {command[-1]: tried([*command, *flags], tmp_path / "sources") for command in compilers()}
    assert {name: text for name, text in said.items() if text} == {}


@pytest.mark.slow
def test_a_binary_for_another_machine(tmp_path: Path) -> None:
    """That for Windows takes a minute: it is made in tests/wheel."""
    pytest.importorskip("ziglang", reason="ziglang is a tool of development")
    plant = plant_of("pi")
    export = export_fmu(plant.simulator, plant.rest, version="3.0", platforms=("linux64", "darwin64"))
    assert export.platforms == ("linux64", "darwin64")
    assert {"x86_64-linux", "x86_64-darwin"} == {
        path.split("/")[1] for path in export.files if path.startswith("binaries")
    }
    assert validate_fmu(str(export.write(tmp_path / "two.fmu"))) == []


def test_without_a_compiler_there_are_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("compiler", "zig"):
        monkeypatch.setattr(f"hystmpc.codegen.fmu.export.{name}", lambda *_: None)
    done = CliRunner().invoke(app, ["export-fmu", "builtin:pi", "--out", str(tmp_path / "pi.fmu")])
    assert done.exit_code == 0, done.output
    assert "sources only: no C compiler was found for this machine" in " ".join(done.output.split())
    assert validate_fmu(str(tmp_path / "pi.fmu")) == []
    with pytest.raises(ExportError, match="no compiler for win64: install ziglang"):
        export_fmu(plant_of("pi").simulator, plant_of("pi").rest, platforms=["win64"])


def test_a_compiler_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    with pytest.raises(ExportError, match="the C compiler false fails"):
        export_fmu(plant_of("pi").simulator, plant_of("pi").rest)


def test_what_has_no_fmu_is_refused_in_a_line(tmp_path: Path) -> None:
    plant = plant_of("pi")
    sensed = simulator(Chain(EXAMPLES[0], after=(Sensor(0.0, 0.1, 0.0, 0.0, 0.0),)))
    with pytest.raises(ExportError, match="got a sensor in the chain"):
        export_fmu(sensed, (0.0, np.zeros(sensed.chain.state_size)))
    inverse = replace(plant.simulator, inverse=True)
    with pytest.raises(ExportError, match="got an inverse map"):
        export_fmu(inverse, plant.rest)
    study = tmp_path / "study.yaml"
    text = (FILES / "simulate_builtin.yaml").read_text(encoding="utf-8")
    study.write_text(re.sub(r"plant:\n(  .*\n)+", "plant: {device: tendon}\n", text), encoding="utf-8")
    for given_one, words in ((study, "got plant.device tendon"), (tmp_path / "lstm.onnx", "got .*, supported are sim")):
        done = CliRunner().invoke(app, ["export-fmu", str(given_one), "--out", str(tmp_path / "no.fmu")])
        assert re.search(f"export-fmu: {words}", str(done.exception))
    with pytest.raises(ExportError, match=r"got platform win46, available: .* did you mean 'win64'"):
        export_fmu(plant.simulator, plant.rest, platforms=["win46"])


@pytest.mark.slow
def test_the_command_says_what_it_wrote_and_left_out(tmp_path: Path) -> None:
    run, out = CliRunner(), tmp_path / "device.fmu"
    arguments = ["export-fmu", str(FILES / "simulate_builtin.yaml"), "--out", str(out), "--fmi", "3.0"]
    done = run.invoke(app, arguments)
    assert done.exit_code == 0, done.output
    words = " ".join(done.output.split())
    assert "FMI 3.0, co-simulation, a step every 0.04 s, command [mm] to angle [deg]" in words
    assert words.endswith("left out: noise of 0.15 deg")
    assert run.invoke(app, arguments).exit_code != 0
    assert run.invoke(app, [*arguments, "--force"]).exit_code == 0
    out.write_bytes(b"not an FMU")
    assert run.invoke(app, [*arguments, "--force"]).exit_code != 0


@pytest.mark.slow
def test_sources_of_two_link_into_one_program(tmp_path: Path) -> None:
    """With a prefix the names of one FMU do not meet those of another."""
    for name in ("pi", "backlash"):
        plant = plant_of(name)
        files = export_fmu(plant.simulator, plant.rest, name=name, version="3.0").files
        (tmp_path / name).mkdir()
        for path, content in files.items():
            if path.startswith("sources/"):
                (tmp_path / name / Path(path).name).write_bytes(content)
        compile_c([*STRICT, "-Wno-strict-prototypes", "-c", f"{name}/fmu.c", "-o", f"{name}.o"], tmp_path)
    main = "const char *pi_fmi3GetVersion(void), *backlash_fmi3GetVersion(void);\n"
    main += "int main(void) { return pi_fmi3GetVersion()[0] != backlash_fmi3GetVersion()[0]; }\n"
    (tmp_path / "main.c").write_text(main, encoding="utf-8")
    compile_c(["-std=c99", "main.c", "pi.o", "backlash.o", "-o", "both", "-lm"], tmp_path)
    assert subprocess.run([tmp_path / "both"], timeout=60, check=False).returncode == 0


@pytest.mark.slow
@sources_of
def test_it_runs_clean_under_sanitizers(name: str, tmp_path: Path) -> None:
    """Addresses, leaks and undefined behaviour; where their library is missing, undefined behaviour alone."""
    plant = device_of(name)
    export = exported(plant, "3.0", "device", ())
    commands = len(export.described.commands)
    for path, content in export.files.items():
        (tmp_path / Path(path).name).write_bytes(content)
    shutil.copy(Path(__file__).with_name("host.c"), tmp_path)
    defines = [f'-DTOKEN="{export.described.token}"', f"-DSAMPLE_S={plant.dt!r}", f"-DCOMMANDS={commands}"]
    build = [*STRICT, "-Wno-strict-prototypes", *defines, "-g", "-o", "run", "host.c", "fmu.c", "-lm"]
    both = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    if not compilers() or tried([*compilers()[0], *both, *build], tmp_path):
        compile_c(["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error", *build], tmp_path)
    done = subprocess.run([tmp_path / "run"], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, "4 refusals\n"), done.stderr
