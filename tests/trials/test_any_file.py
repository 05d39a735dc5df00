"""Any file of any bytes gets an answer, soon: a trial, or one line of at most 300 characters."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystmpc.trials.check import check
from hystmpc.trials.errors import LONGEST, HystmpcError, LogError
from hystmpc.trials.formats import ENDINGS
from hystmpc.trials.layouts import CANONICAL, LogMapping
from hystmpc.trials.read import AnyLayout, read_log

from .test_ways import drawn
from .written_ways import WAYS

# Values of 1e200 overflow in a correlation: what is judged here is that an answer comes.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

MAPPED = LogMapping.parse({"time": "t", "command": "u", "angle": "[2]"})
LAYOUTS: tuple[AnyLayout, ...] = ("auto", "tendon-catheter", MAPPED)
KEEP = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


def answered(path: Path, layout: AnyLayout = "auto") -> str:
    """The refusal, empty where the file is read; anything else that is raised is a failure."""
    refusal = ""
    for read in (read_log, check):
        try:
            read(path, layout)
        except HystmpcError as error:
            refusal = str(error)
            assert "\n" not in refusal
            assert len(f"error: {refusal}") <= 300
    return refusal


ENDS = st.sampled_from([".csv", *ENDINGS])
STARTS = st.sampled_from(
    [b"", b"PK\x03\x04", b"TDSm", b"\x93NUMPY\x01\x00", b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"LabVIEW Measurement\n"]
    + [
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"sep=;\n",
        b"time_s,command,angle_deg\n",
        b"time_s;command;angle_deg\n",
        b"[",
        b"{",
    ]
)


@KEEP
@given(start=STARTS, content=st.binary(max_size=300), end=ENDS, layout=st.sampled_from(LAYOUTS))
def test_any_bytes_are_answered(start: bytes, content: bytes, end: str, layout: AnyLayout, tmp_path: Path) -> None:
    path = tmp_path / f"log{end}"
    path.write_bytes(start + content)
    answered(path, layout)


CELLS = st.one_of(
    st.sampled_from(
        ["", "1,5", "1.5", "-", "1,234", "1.234,5", "09:15:00.5", "24.10.2022", "2022-13-41 25:61", "inf", "9" * 400]
    )
    | st.floats().map(repr)
    | st.integers().map(str)
    | st.datetimes().map(str)
    | st.text(max_size=12)
)


@KEEP
@given(
    rows=st.lists(st.lists(CELLS, max_size=5), max_size=8),
    sign=st.sampled_from([",", ";", "\t", "|", " "]),
    header=st.booleans(),
    layout=st.sampled_from(LAYOUTS),
)
def test_any_cells_are_answered(
    rows: list[list[str]], sign: str, header: bool, layout: AnyLayout, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    above = [sign.join(("time_s", "command", "angle_deg"))] if header else []
    text = "\n".join([*above, *(sign.join(row) for row in rows)])
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    answered(path, layout)


@pytest.mark.parametrize(
    "way", ["quoted decimal commas", "american dates", "a row an event", "units below", "LabVIEW", "utf-16"]
)
@settings(KEEP, max_examples=25)
@given(changes=st.lists(st.tuples(st.integers(0, 10_000), st.binary(max_size=4)), min_size=1, max_size=4))
def test_a_log_that_was_changed_anywhere_is_answered(
    way: str, changes: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    path = WAYS[way](tmp_path, *drawn(1))
    content = bytearray(path.read_bytes())
    for place, new in changes:
        at = place % len(content)
        content[at : at + len(new) + 1] = new
    path.write_bytes(bytes(content))
    answered(path)


@pytest.mark.parametrize("way", ["Excel", "NumPy", "NumPy records", "TDMS", "ROS 1", "MATLAB"])
@settings(KEEP, max_examples=25)
@given(data=st.data())
def test_a_binary_log_that_was_cut_or_changed_is_answered(way: str, data: st.DataObject, tmp_path: Path) -> None:
    if way != "MATLAB":  # SciPy's reader can crash on bytes that were changed, see the page on logs
        pytest.importorskip({"Excel": "openpyxl", "TDMS": "nptdms", "ROS 1": "rosbags"}.get(way, "numpy"))
    whole = next(tmp_path.glob("log.*"), None) or WAYS[way](tmp_path, *drawn(1))
    path = tmp_path / f"changed{whole.suffix}"
    content = bytearray(whole.read_bytes())
    if way != "MATLAB" and data.draw(st.booleans()):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + 4] = data.draw(st.binary(min_size=1, max_size=4))
    else:
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    path.write_bytes(bytes(content))
    answered(path)


LARGE: dict[str, Callable[[int], bytes]] = {
    "one line of JSON": lambda n: json.dumps({"data": [[k, 0.5 * k, 1.0] for k in range(n // 20)]}).encode(),
    "lines of JSON": lambda n: b'{"t": 1, "u": 2}\n' * (n // 17),
    "one line of numbers": lambda n: b"1.5," * (n // 4),
    "one line of letters": lambda n: b"abcdef ghij, " * (n // 13),
    "one long cell": lambda n: b"1" * n,
    "one long word of digits and a letter": lambda n: b"time_s,command,angle_deg\n" + b"1" * n + b"x,2,3\n4,5,6\n",
    "an open quote": lambda n: b'time_s,command,angle_deg\n1,"2,3\n' + b"1,2,3\n" * (n // 6),
    "blanks": lambda n: b"time_s,command,angle_deg\n1,2,3\n4,5,6" + b" " * n + b"\n",
    "blank lines": lambda n: b"\n" * n + b"time_s,command,angle_deg\n1,2,3\n4,5,6\n" + b"\n" * n,
    "many columns": lambda n: (
        b",".join(b"c%d" % k for k in range(4000)) + b"\n" + (b",".join([b"1"] * 4000) + b"\n") * 40
    ),
    "wide rows of one name": lambda n: b"x," * 4000 + b"\n" + b"1," * 4000 + b"\n",
    "text in every row": lambda n: b"name,place\n" + b"some,where\n" * (n // 11),
    "dates alone": lambda n: b"time_s,command,angle_deg\n" + b"2022-10-24 09:15:00,-,-\n" * (n // 24),
    "colons": lambda n: b"time_s,command,angle_deg\n" + b":" * n + b",1,2\n1,2,3\n",
    "zeros": lambda n: bytes(n),
    "random": lambda n: np.random.default_rng(1).bytes(n),
}


@pytest.mark.parametrize("kind", LARGE)
def test_a_large_file_is_answered_soon(kind: str, tmp_path: Path) -> None:
    """What is bounded is the time of the processor; two million bytes of some of these took minutes."""
    path = tmp_path / "log.csv"
    path.write_bytes(LARGE[kind](300_000))
    before = time.process_time()
    answered(path)
    assert time.process_time() - before < 4


class Counted(str):
    """A name that counts how often it is compared."""

    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


@pytest.mark.parametrize("count", [500, 2000])
def test_names_of_columns_are_spelled_in_steps_that_their_number_bounds(count: int) -> None:
    """What took 21 s for a line of 18,001 cells: each was looked for among all."""
    Counted.compared = 0
    CANONICAL.spelled([Counted(f"c{k}") for k in range(count)])
    assert Counted.compared <= 4 * count


FOREIGN = {
    "log.json": (b'{"time": [0, 1], "angle": [1, 2]}', "JSON"),
    "log.txt": (b"[[0, 1, 2], [1, 2, 3]]", "JSON"),
    "log.xml": (b'<?xml version="1.0"?><a/>', "XML"),
    "log.parquet": (b"PAR1" + bytes(40), "Parquet"),
    "log.h5": (b"\x89HDF\r\n\x1a\n" + bytes(600), "HDF5"),
    "log.ulg": (b"ULog\x01\x12\x35\x01" + bytes(40), "ULog"),
    "log.mf4": (b"MDF     4.10    " + bytes(40), "MDF"),
    "log.xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(40), "Excel"),
    "log.pdf": (b"%PDF-1.7\n", "PDF"),
    "log.csv.gz": (b"\x1f\x8b\x08" + bytes(40), "gzip"),
    "log.db": (b"SQLite format 3\x00" + bytes(90), "SQLite"),
    "log.png": (b"\x89PNG\r\n\x1a\n" + bytes(40), "image"),
    "log.pkl": (b"\x80\x04\x95" + bytes(40), "pickle"),
    "log.feather": (b"ARROW1\x00\x00" + bytes(40), "Feather"),
    "log.csv": (b"\x89PNG\r\n\x1a\n" + bytes(40), "image"),
    "simulator.yaml": (b"simulator: {python: tip:Tip}\n", "YAML"),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_a_format_that_is_not_read_is_named_with_what_to_do(name: str, tmp_path: Path) -> None:
    content, called = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    refusal = answered(tmp_path / name)
    assert name in refusal
    assert called in refusal
    assert any(word in refusal for word in ("CSV", "convert", "unpack", "save", "numpy", "expected"))
    assert "which is not read" in refusal


@pytest.mark.filterwarnings("error")
def test_a_header_without_rows_is_refused_and_nothing_else_is_said(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,command,angle_deg\n")
    assert "header only" in answered(tmp_path / "log.csv")


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    text = b"time_s,command,angle_deg\n0,1,2\n1,2,3\n"
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb") as file:
        file.write(text)
    try:
        assert len(read_log(f"/dev/fd/{reading}")) == 2
    finally:
        os.close(reading)


@given(place=st.text(max_size=400), rest=st.text(max_size=2000))
def test_the_text_of_an_error_is_short_and_keeps_its_end(place: str, rest: str) -> None:
    text = f"/{place}/log.csv: {rest}; do this"
    said = str(LogError(text))
    assert len(said) <= LONGEST
    assert said.endswith("; do this")
    assert said == text or len(text) > LONGEST


def test_a_table_is_read_without_the_readers_of_other_formats(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,command,angle_deg\n0,0,30\n0.1,1,31\n0.2,2,33\n")
    code = (
        "import sys; from hystmpc.trials.read import read_trials; read_trials(sys.argv[1]); "
        "sys.exit(' '.join(n for n in ('arrays', 'mat_', 'mcap_', 'messages') if f'hystmpc.trials.{n}' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""
