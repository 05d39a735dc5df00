"""MCAP files of any program: fields by topic, one time base for signals with stamps of their own, errors, damage."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")
pytest.importorskip("rosbags", reason="rosbags (extra `logs`) is not installed")

from mcap.writer import CompressionType

from hystmpc.trials.check import Severity, check
from hystmpc.trials.csv_files import read_csv, write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.mcap_ import open_mcap
from hystmpc.trials.read import read_log, read_trials
from hystmpc.trials.run_folder import RunFolder

from .message_logs import assert_prefix, columns, mapping, read_or_refused, write_json

ONE_TOPIC = [("/bench", 0.1 * k, {"u": {"mm": 1.0 * k}, "tip": [math.radians(10.0 * k)], "i": k}) for k in range(6)]
BENCH = mapping(command="/bench.u.mm", angle={"signal": "/bench.tip[0]", "unit": "rad"}, channels={"i": "/bench.i"})


def test_fields_of_one_topic_are_a_trial(tmp_path: Path) -> None:
    trial = read_log(write_json(tmp_path / "a.mcap", ONE_TOPIC), BENCH)
    assert columns(trial) == {
        "t": [0, 0.1, 0.2, 0.3, 0.4, 0.5],
        "command": [0, 1, 2, 3, 4, 5],
        "angle": [0, 10, 20, 30, 40, 50],
    }
    assert trial.channels["i"].tolist() == [0, 1, 2, 3, 4, 5]
    assert (trial.units.command, trial.units.angle, trial.source) == ("mm", "deg", str(tmp_path / "a.mcap"))


@pytest.mark.parametrize(
    ("unit", "expected", "factor"),
    [("m", "mm", 1e3), ("MPa", "bar", 10), ("Pa", "bar", 1e-5), ("kPa", "kPa", 1), ("psi", "bar", 0.0689475729)],
)
def test_units_come_from_the_mapping(unit: str, expected: str, factor: float, tmp_path: Path) -> None:
    command = {"signal": "/bench.i", "unit": unit, "scale": 2.0, "offset": 1.0}
    trial = read_log(write_json(tmp_path / "a.mcap", ONE_TOPIC), mapping(command=command, angle="/bench.u.mm"))
    assert trial.units.command == expected
    np.testing.assert_allclose(trial.command, factor * (2.0 * np.arange(6) + 1.0))


TWO_TOPICS = mapping(command="/cmd.u", angle="/tip.deg", channels={"force": "/cell.n"})


def test_signals_with_stamps_of_their_own_meet_on_the_angles(tmp_path: Path) -> None:
    """The command holds its last value, a measured channel is interpolated, outside its span it is unknown."""
    messages = [("/cmd", t, {"u": u}) for t, u in ((0.0, 1.0), (0.25, 2.0), (0.45, 3.0))]
    messages += [("/tip", t, {"deg": 100 * t}) for t in (-0.1, 0.1, 0.2, 0.3, 0.4, 0.6)]
    messages += [("/cell", t, {"n": 10 * t}) for t in (0.15, 0.35)]
    path = write_json(tmp_path / "a.mcap", sorted(messages, key=lambda m: m[1]))
    trial = read_log(path, TWO_TOPICS)
    assert columns(trial) == {"t": [0.2, 0.3, 0.4, 0.5], "command": [1, 1, 2, 2], "angle": [10, 20, 30, 40]}
    np.testing.assert_allclose(trial.channels["force"], [np.nan, 2.0, 3.0, np.nan])
    by_command = read_log(path, TWO_TOPICS.model_copy(update={"base": "command"}))
    assert columns(by_command) == {"t": [0.1, 0.35, 0.55], "command": [1, 2, 3], "angle": [0, 25, 45]}


@given(
    commands=st.lists(st.tuples(st.integers(0, 50), st.integers(-9, 9)), min_size=1, max_size=12),
    angles=st.lists(st.integers(0, 50), min_size=2, max_size=12, unique=True),
)
@settings(max_examples=30)
def test_a_command_is_never_seen_before_it_was_sent(
    commands: list[tuple[int, int]], angles: list[int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    sent = sorted(commands, key=lambda c: c[0])
    messages: list[tuple[str, float, Any]] = [("/cmd", t, {"u": u}) for t, u in sent]
    messages += [("/tip", t, {"deg": t}) for t in sorted(angles)]
    path = write_json(tmp_path_factory.mktemp("log") / "a.mcap", sorted(messages, key=lambda m: m[1]))
    trial = read_or_refused(path, mapping(command="/cmd.u", angle="/tip.deg"))
    inside = [t for t in sorted(angles) if sent[0][0] <= t <= sent[-1][0]]
    assert (trial is None) == (len(inside) < 2)
    if trial is not None:
        assert trial.angle.tolist() == inside
        assert trial.command.tolist() == [[u for s, u in sent if s <= t][-1] for t in inside]


def test_time_may_come_from_the_header_or_a_field(tmp_path: Path) -> None:
    messages = [
        ("/a", 0.5 + 0.1 * k, {"header": {"stamp": {"sec": k, "nanosec": 500}}, "ms": 20 * k, "u": k, "y": k})
        for k in range(4)
    ]
    path = write_json(tmp_path / "a.mcap", messages)
    fields = {"command": "/a.u", "angle": "/a.y"}
    assert columns(read_log(path, mapping(**fields, time="header")))["t"] == [0, 1, 2, 3]
    for time in ("/a.ms", "ms"):
        assert columns(read_log(path, mapping(**fields, time=time, time_unit="ms")))["t"] == [0, 0.02, 0.04, 0.06]
    assert columns(read_log(path, mapping(**fields, rate_hz=10)))["t"] == [0, 0.1, 0.2, 0.3]


FAULTS = [
    ({"command": "/cmd.u"}, ["no topic of signal '/cmd.u'", "topics: /bench, /other"]),
    ({"command": "/bench.u.cm"}, ["topic '/bench' (any) has no 'u.cm'", "available: u.mm, tip[0], i"]),
    ({"command": "/bench.tip[1]"}, ["has no 'tip[1]'"]),
    ({"command": "/other.text"}, ["'text' is str, expected a number"]),
    ({"time": "header"}, ["has no 'header'"]),
    ({"time": "/other.n"}, ["another topic than '/bench'"]),
    ({"command": "/other.n"}, ["share 0 samples"]),
]


@pytest.mark.parametrize(("change", "parts"), FAULTS)
def test_errors_name_file_topic_and_what_there_is(change: dict[str, str], parts: list[str], tmp_path: Path) -> None:
    messages = [*ONE_TOPIC, ("/other", 9.0, {"n": 1, "text": "x"}), ("/other", 9.5, {"n": 1, "text": "x"})]
    path = write_json(tmp_path / "run_07.mcap", messages)
    with pytest.raises(LogError) as caught:
        read_log(path, mapping(**{"command": "/bench.u.mm", "angle": "/bench.tip[0]"} | change))
    for part in ["run_07.mcap", *parts]:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_mapping_only_our_own_names_are_known(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", ONE_TOPIC)
    with pytest.raises(LogError, match=r"expected these, or a mapping file after --layout; available: /bench\.u\.mm"):
        read_log(path)
    with pytest.raises(ConfigError, match="layout tendon-catheter is for delimited text"):
        read_log(path, "tendon-catheter")
    with pytest.raises(ConfigError, match="unknown layout 'tendon'"):
        read_log(path, "tendon")


def test_the_log_of_a_simulation_reads_like_its_table(tmp_path: Path) -> None:
    run = RunFolder.create(tmp_path / "run", {})
    t = np.arange(50) / 50
    run.write_log({"time_s": t, "command_bar": np.sin(t), "angle_deg": t**2, "source": ["mpc"] * 50, "x": -t})
    table, messages = read_log(run.path / "log.csv"), read_log(run.path / "log.mcap")
    assert columns(messages) == columns(table)
    assert messages.units == table.units
    np.testing.assert_array_equal(messages.channels["x"], table.channels["x"])


MAPPING_FILE = """\
command: {signal: /bench.u.mm}
angle: {signal: "/bench.tip[0]", unit: rad}
"""


def test_a_mapping_file_is_what_a_layout_may_be(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", ONE_TOPIC)
    layout = tmp_path / "bench.yaml"
    layout.write_text(MAPPING_FILE)
    assert columns(read_trials([tmp_path], str(layout))[0]) == columns(read_log(path, BENCH))
    report = check(path, str(layout))
    assert report.layout == "mapping"
    assert report.of("values")[0].severity is Severity.OK
    layout.write_text(MAPPING_FILE.replace("unit: rad", "unit: grad"))
    with pytest.raises(ConfigError, match=r"bench\.yaml, line 2: angle\.unit: .*'deg', 'rad', .*, got 'grad'"):
        read_log(path, str(layout))


def test_a_mapping_reads_tables_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("ms;travel;rad;note\n0;0.001;0.1;a\n20;0.002;0.2;b\n40;0.003;0.3;c\n")
    layout = mapping(
        time="ms", time_unit="ms", command={"signal": "travel", "unit": "m"}, angle={"signal": "rad", "unit": "rad"}
    )
    trial = read_log(path, layout)
    np.testing.assert_allclose(trial.t, [0, 0.02, 0.04])
    np.testing.assert_allclose(trial.command, [1, 2, 3])
    np.testing.assert_allclose(trial.angle, np.degrees([0.1, 0.2, 0.3]))
    with pytest.raises(LogError, match=r"a\.csv: no signal 'travl'; available: ms, rad, travel; did you mean 'travel'"):
        read_log(path, layout.model_copy(update={"command": layout.command.model_copy(update={"signal": "travl"})}))


@pytest.mark.parametrize("sign", ["\t", ",", ";", "  "])
def test_columns_without_a_header_row_are_counted(sign: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_text("\n".join(sign.join(map(str, row)) for row in ((1.5, 0, -3), (2.5, 0, -2), (3.5, 0, 1e1))) + "\n")
    layout = mapping(
        rate_hz=50, command={"signal": "[0]", "unit": "V"}, angle={"signal": "[2]", "scale": 2, "offset": 1}
    )
    trial = read_log(path, layout)
    assert trial.t.tolist() == [0, 0.02, 0.04]
    assert trial.command.tolist() == [1.5, 2.5, 3.5]
    assert trial.angle.tolist() == [-5, -3, 21]
    assert check(path, layout).layout == "mapping"
    with pytest.raises(LogError, match=r"a\.dat: no signal '\[5\]'; available: \[0\], \[1\], \[2\]"):
        read_log(path, layout.model_copy(update={"command": layout.command.model_copy(update={"signal": "[5]"})}))
    path.write_text(path.read_text() + "4.5" + sign + "x" + sign + "1\n")
    with pytest.raises(LogError, match="row 4, column '\\[1\\]': got 'x'"):
        read_log(path, layout.model_copy(update={"command": layout.command.model_copy(update={"signal": "[1]"})}))
    assert len(read_log(path, layout)) == 4  # the column is not asked for
    assert check(path, layout).of("file")[0].message == "column '[1]' left out: row 4 holds 'x', no number"


def test_a_command_may_be_the_difference_of_two_signals(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,pa,pb,q\n0,100,300,1\n0.1,200,250,2\n0.2,350,90,3\n")
    command = {"signal": "pa", "minus": "pb", "scale": -1.0, "offset": 5.0, "unit": "kPa"}
    trial = read_log(
        path, mapping(time="t", command=command, angle="q", channels={"sum": {"signal": "q", "minus": "t"}})
    )
    assert trial.command.tolist() == [205, 55, -255]
    np.testing.assert_allclose(trial.channels["sum"], [1, 1.9, 2.8])
    with pytest.raises(LogError, match="no signal 'pc'"):
        read_log(path, mapping(time="t", command={**command, "minus": "pc"}, angle="q"))
    log = write_json(tmp_path / "b.mcap", ONE_TOPIC)
    itself = mapping(command={"signal": "/bench.i", "minus": "/bench.i"}, angle="/bench.u.mm")
    assert read_log(log, itself).command.tolist() == [0] * 6
    apart = [("/a", 0.1 * k, {"u": k}) for k in range(5)] + [("/b", 0.1 * k + 0.01, {"u": k}) for k in range(5)]
    log = write_json(tmp_path / "c.mcap", apart)
    with pytest.raises(
        LogError, match=r"'/a\.u' and '/b\.u' have other time stamps, expected a difference of two fields"
    ):
        read_log(log, mapping(command={"signal": "/a.u", "minus": "/b.u"}, angle="/b.u"))


def test_an_antagonistic_pair_is_a_difference_and_a_sum(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,pa,pb,q\n0,100,300,1\n0.1,200,250,2\n0.2,350,90,3\n")
    pair = {"signal": "pa", "minus": "pb", "unit": "kPa"}
    both = {"sum_bar": {"signal": "pa", "plus": "pb", "scale": 0.01}}
    trial = read_log(path, mapping(time="t", command=pair, angle="q", inputs=both))
    assert trial.command.tolist() == [-200, -50, 260]
    np.testing.assert_allclose(trial.inputs["sum_bar"], [4, 4.5, 4.4])
    with pytest.raises(ConfigError, match="got minus 'pb' and plus 'pb', expected one of them"):
        mapping(time="t", command={**pair, "plus": "pb"}, angle="q")


def test_a_folder_stands_for_its_tables_and_else_for_its_other_logs(tmp_path: Path) -> None:
    write_json(tmp_path / "b.mcap", ONE_TOPIC)
    write_json(tmp_path / "a.mcap", ONE_TOPIC)
    assert [Path(t.source).name for t in read_trials([tmp_path], BENCH)] == ["a.mcap", "b.mcap"]
    write_csv(read_log(tmp_path / "a.mcap", BENCH), tmp_path / "c.csv")
    assert [Path(t.source).name for t in read_trials([tmp_path])] == ["c.csv"]
    assert columns(read_csv(tmp_path / "c.csv")) == columns(read_log(tmp_path / "a.mcap", BENCH))


@pytest.mark.parametrize("compression", list(CompressionType))
@settings(max_examples=30)
@given(data=st.data())
def test_a_file_cut_anywhere_gives_its_whole_messages(
    data: st.DataObject, compression: CompressionType, tmp_path_factory: pytest.TempPathFactory
) -> None:
    messages = [("/bench", 0.01 * k, {"u": {"mm": math.sin(k)}, "tip": [0.1 * k], "i": k}) for k in range(40)]
    folder = tmp_path_factory.mktemp("cut")
    content = write_json(folder / "whole.mcap", messages, compression).read_bytes()
    whole = read_log(folder / "whole.mcap", BENCH)
    cut = data.draw(st.integers(0, len(content)))
    (folder / "cut.mcap").write_bytes(content[:cut])
    found = read_or_refused(folder / "cut.mcap", BENCH)
    assert_prefix(found, whole)
    if compression is CompressionType.NONE:  # not even the last chunk is lost: every message that is there is read
        there = sum(content.find(f'"i": {k}}}'.encode()) + len(f'"i": {k}}}') <= cut for k in range(40))
        assert (len(found) if found is not None else 0) == (there if there >= 2 else 0)


@settings(max_examples=50)
@given(data=st.data())
def test_any_bytes_are_read_or_refused(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("flip")
    content = bytearray(write_json(folder / "whole.mcap", ONE_TOPIC, CompressionType.LZ4).read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[at] = data.draw(st.integers(0, 255))
    (folder / "flipped.mcap").write_bytes(content)
    read_or_refused(folder / "flipped.mcap", BENCH)


@pytest.mark.parametrize(
    ("content", "text"),
    [(b"", "not an MCAP file"), (b"time_s,command\n", "not an MCAP file"), (b"\x89MCAP0\r\n", "no message in it")],
)
def test_what_is_no_mcap_file_is_refused(content: bytes, text: str, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(LogError, match=text):
        open_mcap(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="no such file"):
        open_mcap(tmp_path / "b.mcap")
