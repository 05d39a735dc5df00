"""Reading and writing logs: every layout, exact round trips, and errors that name file, row and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hystmpc.trials.csv_files import read_columns, read_csv, write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.layouts import COMMAND_UNIT_OF, COMMAND_UNITS, LAYOUTS, Layout, detect_layout, layout_named
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units

NINE = "Time,Tendon Disp.,Motor Curr.,Pos x,Pos y,Pos z,Angle x,Angle y,Angle z"
ELEVEN = "Time, Tendon1 Disp., Tendon2 Disp., Motor1 Curr., Motor2 Curr., " + NINE[NINE.index("Pos x") :]
GOOD = "time_s,command,angle_deg\n0,0,30\n0.1,1,31\n0.2,2,33\n"

CASES = [(layout, command) for layout in LAYOUTS for command in layout.command]


@pytest.mark.parametrize(("layout", "command"), CASES, ids=lambda value: getattr(value, "name", value))
def test_every_layout_reads_its_own_columns(layout: Layout, command: str, tmp_path: Path) -> None:
    header = (layout.time, command, layout.angle, *layout.channels, "unlisted")
    block = np.arange(3.0 * len(header)).reshape(3, -1)
    rows = [header, *(tuple(map(str, row)) for row in block.tolist())]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(";".join(row) for row in rows))

    trial = read_csv(path, layout)

    np.testing.assert_array_equal(trial.t, block[:, header.index(layout.time)])
    unit, factor = COMMAND_UNIT_OF.get(layout.command[command], (layout.command[command], 1.0))
    np.testing.assert_array_equal(trial.command, factor * block[:, header.index(command)])
    np.testing.assert_array_equal(trial.angle, block[:, header.index(layout.angle)])
    assert trial.units == Units(command=unit)
    others = [name for name in header if name not in (layout.time, command, layout.angle)]
    assert list(trial.channels) == [layout.channels.get(name, name) for name in others]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda p: p.name)
def test_every_layout_is_found_by_name_and_by_header(layout: Layout) -> None:
    assert layout_named(layout.name) is layout
    for command in layout.command:
        assert detect_layout([layout.time, command, layout.angle]) is layout


@pytest.mark.parametrize("header", [NINE, ELEVEN])
def test_tendon_catheter_layouts_are_detected(header: str, tmp_path: Path) -> None:
    width = header.count(",") + 1
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *(",".join(str(100 * row + k) for k in range(width)) for row in range(3))]))
    trial = read_csv(path)
    assert trial.command.tolist() == [1, 101, 201]
    assert trial.angle.tolist() == [start + width - 3 for start in (0, 100, 200)]
    assert len(trial.channels) == width - 3


def test_unknown_layout_names_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'tendon-cathter', available: auto, .*did you mean 'tendon-catheter'"):
        read_csv(tmp_path / "absent.csv", "tendon-cathter")


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.rstrip("\n"),
        lambda text: text + "\n\n",
        lambda text: text.replace(",", " , "),
        lambda text: text.replace("30", '"30"'),
        lambda text: text.replace("\n", ",\n"),
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", ";").replace("0.1", "0,1").replace("0.2", "2,0e-1"),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace(",", "  "),
        lambda text: text.replace("time_s,command,angle_deg", "Time_s,COMMAND,Angle_Deg"),
    ],
    ids=["bom", "crlf", "no last newline", "blank lines", "spaces", "quotes", "trailing commas"]
    + ["semicolons", "decimal commas", "tabs", "columns of spaces", "capitals"],
)
def test_harmless_differences_of_the_text_do_not_matter(change, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(change(GOOD).encode())
    trial = read_csv(path)
    assert (trial.t.tolist(), trial.angle.tolist(), dict(trial.channels)) == ([0, 0.1, 0.2], [30, 31, 33], {})


BAD = {
    "empty": (b"", ["empty file"]),
    "blank": (b"\n \n", ["empty file"]),
    "binary": (bytes(range(256)), ["binary", "offset 0"]),
    "header only": (b"time_s,command,angle_deg\n", ["header only"]),
    "one row": (b"time_s,command,angle_deg\n0,1,2\n", ["1 samples", "at least 2"]),
    "text in first row": (GOOD.replace("0,0,30", "0,0,thirty").encode(), ["row 2", "'angle_deg'", "'thirty'"]),
    "text in a later row": (GOOD.replace("31", "3l").encode(), ["row 3", "'angle_deg'", "'3l'", "number"]),
    "underscore": (GOOD.replace("31", "3_1").encode(), ["row 3", "'3_1'"]),
    "nan": (GOOD.replace("33", "NaN").encode(), ["row 4", "'angle_deg'", "'NaN'", "finite"]),
    "inf": (GOOD.replace("0.1,1", "0.1,-inf").encode(), ["row 3", "'command'", "'-inf'", "finite"]),
    "empty cell": (GOOD.replace("0.1,1", "0.1,").encode(), ["row 3", "'command'", "empty cell"]),
    "short row": (GOOD.replace("0.1,1,31", "0.1,1").encode(), ["row 3", "2 cells", "expected 3"]),
    "long row": (GOOD.replace("0.1,1,31", "0.1,1,31,7").encode(), ["row 3", "4 cells", "expected 3"]),
    "blank line before": (GOOD.replace("0.1,1,31", "\n0.1,1,x").encode(), ["row 4", "'x'"]),
    "time repeats": (GOOD.replace("0.2,", "0.1,").encode(), ["row 4", "'time_s'", "0.1 s after 0.1 s"]),
    "column twice": (b"time_s,command,command,angle_deg\n0,1,1,2\n", ["row 1", "'command' occurs twice"]),
    "two commands": (b"time_s,command_mm,command_bar,angle_deg\n0,1,1,2\n", ["command_mm, command_bar"]),
    "other names": (b"t,u,theta\n0,0,30\n", ["available: t, u, theta", "map.yaml", "angle: {signal: NAME"]),
    "decimal commas": (b"time_s;command;angle_deg\n0,0;1,1;2,2,2\n", ["row 2", "'2,2,2'"]),
    "no header": (b"0,0,30\n0.1,1,31\n", ["row 1", "first row holds numbers"]),
    "open quote": (b'time_s,command,angle_deg\n0,0,30\n1,"' + b"1,2\n" * 50_000, ["row", "limit"]),
}


@pytest.mark.parametrize(("data", "parts"), BAD.values(), ids=BAD)
def test_a_log_that_cannot_be_used_is_named_with_its_fault(data: bytes, parts: list[str], tmp_path: Path) -> None:
    path = tmp_path / "trial_07.csv"
    path.write_bytes(data)
    with pytest.raises(LogError) as caught:
        read_csv(path)
    text = str(caught.value)
    assert "\n" not in text
    for part in ["trial_07.csv", *parts]:
        assert part in text


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda p: p.name)
def test_missing_columns_are_listed_with_those_available(layout: Layout, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{layout.time},pressure\n0,1\n1,2\n")
    nearest = next(one for one in LAYOUTS if one.time == layout.time)  # of equally near ones the first
    for chosen, wanted in ((layout.name, layout), ("auto", nearest)):
        with pytest.raises(LogError) as caught:
            read_csv(path, chosen)
        text = str(caught.value)
        assert wanted.angle in text
        assert next(iter(wanted.command)) in text
        assert f"available: {layout.time}, pressure" in text


def test_missing_file_and_folder_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"absent\.csv: no such file"):
        read_csv(tmp_path / "absent.csv")
    with pytest.raises(LogError, match="is a folder"):
        read_csv(tmp_path)


def test_further_columns_may_be_empty_or_text(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,command,angle_deg,current,source\n0,0,30,,mpc\n0.1,1,31,2.5,hold\n")
    trial = read_csv(path)
    assert list(trial.channels) == ["current"]
    np.testing.assert_array_equal(trial.channels["current"], [np.nan, 2.5])
    cells = read_columns(path).cells
    assert cells is not None
    assert cells.table.texts == {"source": ("mpc", "hold")}


def test_a_latin_1_header_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes("time_s,command,angle_deg,temp °C\n0,0,30,20\n1,1,31,21\n".encode("latin-1"))
    assert list(read_csv(path).channels) == ["temp °C"]


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)


@st.composite
def trials(draw: st.DrawFn) -> Trial:
    count = draw(st.integers(2, 20))
    t = np.array(sorted(draw(st.lists(NUMBERS, min_size=count, max_size=count, unique=True))))
    signal = arrays(np.float64, count, elements=NUMBERS)
    noisy = arrays(np.float64, count, elements=st.floats(allow_infinity=False))
    names = draw(st.lists(NAMES.filter(lambda name: "command" not in name), max_size=3, unique=True))
    channels = {name: draw(noisy) for name in names}
    return Trial(t, draw(signal), draw(signal), channels, Units(command=draw(st.sampled_from(COMMAND_UNITS))))


@settings(deadline=None)
@given(trial=trials())
def test_what_is_written_reads_back_exactly(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = write_csv(trial, tmp_path_factory.mktemp("round") / "trial.csv")
    back = read_csv(path)
    for name in ("t", "command", "angle"):
        np.testing.assert_array_equal(getattr(back, name), getattr(trial, name))
    assert list(back.channels) == list(trial.channels)
    for name, values in trial.channels.items():
        np.testing.assert_array_equal(back.channels[name], values)
    assert back.units == trial.units
    assert [file.name for file in path.parent.iterdir()] == ["trial.csv"]


def test_a_channel_may_not_take_a_canonical_name(tmp_path: Path) -> None:
    trial = Trial(np.arange(2.0), np.zeros(2), np.zeros(2), {"command_bar": np.zeros(2)})
    with pytest.raises(LogError, match="'command_bar'"):
        write_csv(trial, tmp_path / "x.csv")
    assert not list(tmp_path.iterdir())


def test_units_that_the_header_cannot_name_are_refused(tmp_path: Path) -> None:
    trial = Trial(np.arange(2.0), np.zeros(2), np.zeros(2), units=Units(command="furlong"))
    with pytest.raises(LogError, match=r"furlong.*expected a command in mm, bar"):
        write_csv(trial, tmp_path / "x.csv")


def test_a_folder_stands_for_its_logs_in_order(tmp_path: Path) -> None:
    for name in ("b.csv", "a.csv", "notes.txt"):
        (tmp_path / name).write_text(GOOD)
    single = tmp_path / "notes.txt"
    assert [Path(t.source).name for t in read_trials([single, tmp_path])] == ["notes.txt", "a.csv", "b.csv"]


def test_nothing_found_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no \*\.csv"):
        read_trials([tmp_path])
    with pytest.raises(LogError, match="no logs given"):
        read_trials([])


def test_the_real_logs_start_at_thirty_degrees(real_logs: list[Path]) -> None:
    for trial in read_trials(real_logs):
        assert trial.angle[0] == 30.0
        assert trial.units == Units("mm", "deg")
        assert 1 / trial.dt == pytest.approx(500, rel=0.02)
        assert set(trial.channels) == {"motor_current", "pos_x", "pos_y", "pos_z", "angle_y_deg", "angle_z_deg"}
