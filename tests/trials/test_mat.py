"""MATLAB files, v5 and v7.3: variables, structs, columns, time or rate; errors and damage."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

pytest.importorskip("h5py", reason="h5py (extra `logs`) is not installed")
pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")
pytest.importorskip("rosbags", reason="rosbags (extra `logs`) is not installed")

import h5py

from hystmpc.cli.main import main
from hystmpc.trials.check import check
from hystmpc.trials.errors import LogError
from hystmpc.trials.mat_ import open_mat
from hystmpc.trials.read import read_log, read_trials

from .message_logs import assert_prefix, columns, mapping, read_or_refused

T = np.arange(30) / 50
U, Y = np.sin(T), np.radians(30 + 20 * np.sin(T - 0.1))


def write_v5(path: Path, variables: Mapping[str, Any]) -> None:
    """As MATLAB's `save -v6` or `-v7` writes: vectors become columns."""
    savemat(path, dict(variables), oned_as="column", do_compression=path.stem.endswith("7"))


def write_v73(path: Path, variables: Mapping[str, Any]) -> None:
    """As `save -v7.3` writes: HDF5 behind a block of 512 bytes, structs as groups, matrices transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _group(file, variables)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _group(group: Any, variables: Mapping[str, Any]) -> None:
    for name, value in variables.items():
        if isinstance(value, Mapping):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            _group(inner, value)
        elif isinstance(value, str):
            codes = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
            group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
        else:
            matrix = np.asarray(value, dtype=np.float64)
            column = matrix.reshape(-1, 1) if matrix.ndim == 1 else matrix
            group.create_dataset(name, data=column.T).attrs["MATLAB_class"] = np.bytes_("double")


WRITERS = {"v6.mat": write_v5, "v7.mat": write_v5, "v73.mat": write_v73}
VARIABLES = {
    "time": T,
    "rig": {"travel": 1e-3 * U, "sensor": {"tip": Y}},
    "all": np.column_stack((T, U, Y)),
    "name": "trial 7",
    "gain": 2.0,
}
STRUCTS = mapping(
    time="time",
    command={"signal": "rig.travel", "unit": "m"},
    angle={"signal": "rig.sensor.tip", "unit": "rad"},
    channels={"second": "all[1]"},
)
COLUMNS = mapping(time="all[0]", command="all[1]", angle={"signal": "all[2]", "unit": "rad"})


@pytest.fixture(params=WRITERS)
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    WRITERS[request.param](path, VARIABLES)
    return path


def test_structs_and_columns_are_signals(file: Path) -> None:
    for layout in (STRUCTS, COLUMNS):
        trial = read_log(file, layout)
        np.testing.assert_array_equal(trial.t, T)
        np.testing.assert_allclose(trial.command, U, atol=1e-15)
        np.testing.assert_allclose(trial.angle, np.degrees(Y), rtol=1e-14)
    np.testing.assert_array_equal(read_log(file, STRUCTS).channels["second"], U)
    assert set(open_mat(file).names()) == {"time", "rig.travel", "rig.sensor.tip", "all[0]", "all[1]", "all[2]"}


def test_a_rate_stands_for_a_missing_time(file: Path) -> None:
    layout = {"command": "all[1]", "angle": "all[2]"}
    np.testing.assert_allclose(read_log(file, mapping(**layout, rate_hz=50)).t, T)
    with pytest.raises(LogError, match="expected `time: SIGNAL` or `rate_hz` in the mapping"):
        read_log(file, mapping(**layout))


@pytest.mark.parametrize("name", WRITERS)
def test_variables_of_canonical_names_need_no_mapping(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name, {"time_s": T, "command_bar": U, "angle_deg": Y, "current": 2 * U})
    (trial,) = read_trials([tmp_path])
    assert trial.units.command == "bar"
    np.testing.assert_array_equal(trial.command, U)
    np.testing.assert_array_equal(trial.channels["current"], 2 * U)
    assert check(tmp_path / name).of("values")[0].severity == "ok"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"command": "rig.travl"}, r"no signal 'rig\.travl'; available: all\[0\].* did you mean 'rig\.travel'"),
        ({"command": "all[3]"}, r"no signal 'all\[3\]'"),
        (
            {"command": "all"},
            r"'all' is a 30x3 float64 value, expected a vector.*name one of its signals, counted from 0: all\[0\]",
        ),
        ({"command": "gain"}, r"'gain' has 1 samples, expected 30 as in 'time'"),
        ({"command": "rig"}, r"'rig' is a single object value, expected a vector"),
        ({"time": "clock"}, r"no signal 'clock'"),
    ],
)
def test_errors_name_file_variable_and_what_there_is(change: dict[str, str], text: str, file: Path) -> None:
    with pytest.raises(LogError, match=text) as caught:
        read_log(file, mapping(**{"time": "time", "command": "rig.travel", "angle": "rig.sensor.tip"} | change))
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_values_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    write_v5(tmp_path / "a.mat", {"time_s": T, "command": np.where(T > 0.3, np.nan, U), "angle_deg": Y})
    with pytest.raises(LogError, match=r"command is nan at sample 16, expected finite values \(14 such\)"):
        read_log(tmp_path / "a.mat")
    assert "not finite, first at sample 16" in check(tmp_path / "a.mat").of("values")[0].message


@pytest.mark.parametrize(
    ("content", "text"),
    [(b"", "not a readable MATLAB file"), (b"time,angle\n0,1\n" * 99, "not a readable MATLAB file")],
)
def test_what_is_no_matlab_file_is_refused(content: bytes, text: str, tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(LogError, match=text):
        open_mat(tmp_path / "a.mat")
    with pytest.raises(LogError, match="no such file"):
        open_mat(tmp_path / "b.mat")


def test_a_struct_array_is_a_list(tmp_path: Path) -> None:
    """What Simulink saves as a structure with time: signals is an array of structs."""
    savemat(tmp_path / "a.mat", {"out": {"time": T, "signals": [{"values": U}, {"values": Y}]}}, oned_as="column")
    layout = mapping(time="out.time", command="out.signals[0].values", angle="out.signals[1].values")
    trial = read_log(tmp_path / "a.mat", layout)
    assert columns(trial)["command"] == np.round(U, 9).tolist()
    assert columns(trial)["angle"] == np.round(Y, 9).tolist()


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=30)
@given(data=st.data())
def test_a_file_cut_anywhere_is_read_whole_or_refused(
    name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    write: Callable[[Path, Mapping[str, Any]], None] = WRITERS[name]
    write(folder / name, VARIABLES)
    whole, content = read_log(folder / name, STRUCTS), (folder / name).read_bytes()
    (folder / "cut.mat").write_bytes(content[: data.draw(st.integers(0, len(content)))])
    assert_prefix(read_or_refused(folder / "cut.mat", STRUCTS), whole)


def _self_link(file: Any) -> None:
    group = file.create_group("g")
    group["again"] = group


def _link_to_the_root(file: Any) -> None:
    file.create_group("g")["up"] = file["/"]


def _ring(file: Any) -> None:
    """Four groups, each with a link to every one: a walk of eight levels meets 4^9 objects."""
    groups = [file.create_group(f"g{k}") for k in range(4)]
    for group in groups:
        for k, other in enumerate(groups):
            group[f"l{k}"] = other


def _cell_of_itself(file: Any) -> None:
    cell = file.create_dataset("cell", (1,), dtype=h5py.special_dtype(ref=h5py.Reference))
    cell[0] = cell.ref


def _soft_link_to_itself(file: Any) -> None:
    file.create_group("g")["s"] = h5py.SoftLink("/g/s")


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (_self_link, "'/g/again' is linked to from within itself, expected no loop"),
        (_link_to_the_root, "'/g/up' is linked to from within itself, expected no loop"),
        (_ring, "'/g0/l0' is linked to from within itself, expected no loop"),
        (_cell_of_itself, "'/cell' is linked to from within itself, expected no loop"),
        (_soft_link_to_itself, "too many links"),
    ],
)
def test_links_that_form_a_loop_are_refused_in_one_line(
    build: Callable[[Any], None], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with h5py.File(tmp_path / "loop.mat", "w", userblock_size=512) as file:
        build(file)
    with pytest.raises(LogError) as caught:
        open_mat(tmp_path / "loop.mat")
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
    before, sys.argv = sys.argv, ["hystmpc", "check", str(tmp_path / "loop.mat")]
    try:
        with pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = before
    assert (end.value.code, capsys.readouterr().err) == (2, f"error: {caught.value}\n")


@pytest.mark.parametrize(("kind", "remedy"), [("table", "writetable(run"), ("timetable", "writetimetable(run")])
@pytest.mark.parametrize("version", ["7", "7.3"])
@pytest.mark.parametrize("layout", ["auto", "of_it", "of_another"])
def test_a_table_of_matlab_is_named_with_what_to_do(
    kind: str, remedy: str, version: str, layout: str, tmp_path: Path
) -> None:
    """Only MATLAB can read its objects; whatever is asked for, the line says how to save one."""
    path = tmp_path / "a.mat"
    if version == "7":
        path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + _object_v5(b"run", kind.encode()))
    else:
        write_v73(path, {"t": T, "run": T})
        with h5py.File(path, "r+") as file:
            file["run"].attrs["MATLAB_class"] = np.bytes_(kind)
            file["run"].attrs["MATLAB_object_decode"] = 3
    name = "run" if layout == "of_it" else "other"
    asked = "auto" if layout == "auto" else mapping(time=f"{name}.t", command=f"{name}.u", angle=f"{name}.y")
    with pytest.raises(LogError) as caught:
        read_log(path, asked)
    assert f"'run' is a MATLAB {kind}, which only MATLAB can read; save it there with {remedy}" in str(caught.value)


def _object_v5(name: bytes, kind: bytes) -> bytes:
    """An object of MATLAB as it stands in a file: what it holds is elsewhere, in a form that is not published."""

    def element(number: int, content: bytes) -> bytes:
        return struct.pack("<II", number, len(content)) + content + b"\0" * (-len(content) % 8)

    flags = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    inner = element(14, flags + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    outer = element(6, struct.pack("<II", 17, 0)) + element(1, name) + element(1, b"MCOS") + element(1, kind)
    return element(14, outer + inner)


def test_one_object_under_two_names_is_no_loop(tmp_path: Path) -> None:
    write_v73(tmp_path / "a.mat", {"run": {"t": T}})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["again"] = file["run"]
    assert open_mat(tmp_path / "a.mat").names() == ("again.t", "run.t")


@pytest.mark.slow
def test_links_that_fan_out_end_at_a_bound(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "fan.mat", "w", userblock_size=512) as file:
        groups = [file.create_group(f"g{k}") for k in range(9)]
        for group, following in pairwise(groups):
            for k in range(10):
                group[f"l{k}"] = following
    with pytest.raises(LogError, match="more than 20000 objects, each link counted"):
        open_mat(tmp_path / "fan.mat")
