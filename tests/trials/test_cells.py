"""Columns of cells as text: decimal marks, thousands, dates; where nothing tells them apart it is said."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.cells import convert
from hystmpc.trials.csv_files import read_columns, read_csv
from hystmpc.trials.errors import LogError
from hystmpc.trials.signals import is_merged, merged
from hystmpc.trials.tables import text_table


def numbers(*columns: Sequence[str], comma_likely: bool = False) -> list[list[float] | str]:
    """Values of every column, or why it is none of numbers."""
    found = convert(columns, comma_likely)
    return [c.fault[1] or "text" if c.fault else (c.values.tolist() if c.values is not None else "") for c in found]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["1,5", "2"], [1.5, 2.0]),
        (["0,125", "1,250"], [0.125, 1.25]),
        (["1,234.5", "999"], [1234.5, 999.0]),
        (["1.234,5", "999"], [1234.5, 999.0]),
        (["1,234,567", "1"], [1234567.0, 1.0]),
        (["1'234.5", "1"], [1234.5, 1.0]),
        (["1 234,5", "1"], [1234.5, 1.0]),
        (["\u22121.5", "+2.5E-1"], [-1.5, 0.25]),
        (["1.5", "-", "N/A"], [1.5, np.nan, np.nan]),
        (["", "", "7"], [np.nan, np.nan, 7.0]),
    ],
)
def test_numbers_as_people_write_them(cells: list[str], expected: list[float]) -> None:
    (found,) = numbers(cells)
    np.testing.assert_array_equal(found, expected)


def test_a_column_tells_the_mark_of_the_others() -> None:
    assert numbers(["1,234", "5,678"], ["0,5", "1,5"]) == [[1.234, 5.678], [0.5, 1.5]]
    assert numbers(["1,234", "567"], ["0.5", "1.5"]) == [[1234.0, 567.0], [0.5, 1.5]]


@pytest.mark.parametrize(
    "columns",
    [
        (["1,234", "5,678"],),  # decimals or thousands: nothing tells
        (["1,234", "5,678"], ["0.5", "1.5"]),  # three decimals throughout: thousands would have smaller ones among them
        (["1.234", "5.678"], ["0,5", "1,5"]),
    ],
)
def test_what_may_be_a_decimal_mark_or_part_thousands_is_refused(columns: tuple[list[str], ...]) -> None:
    """A factor of a thousand is no guess to make."""
    assert "decimal mark or part thousands" in str(numbers(*columns)[0])


def test_the_ambiguous_cell_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('time_s,command,angle_deg\n0,"1,234",2\n1,"2,345",3\n')
    with pytest.raises(LogError, match=r"row 2, column 'command': got '1,234', .* may be the decimal mark or part"):
        read_csv(path)


FORMS = ["%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f+00:00", "%Y/%m/%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f"]
FORMS += ["%m/%d/%Y %I:%M:%S.%f %p", "%d/%m/%Y %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f", "%b %d, %Y %H:%M:%S.%f"]
FORMS += ["%a, %d %b %Y %H:%M:%S.%f", "%H:%M:%S.%f", "%y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f-0530"]


@given(
    start=st.datetimes(datetime(2001, 1, 1), datetime(2060, 1, 1)),
    steps=st.lists(st.integers(1, 3_000_000), min_size=2, max_size=30),
    form=st.sampled_from([form for form in FORMS if not form.startswith("%y")]),
)
def test_seconds_since_the_first_stamp_are_exact(start: datetime, steps: list[int], form: str) -> None:
    """Over midnight, the ends of months and years, and whatever the order of day and month."""
    since = np.concatenate(([0], np.cumsum(steps)))
    cells = [(start + timedelta(microseconds=int(step))).strftime(form) for step in since]
    (found,) = convert([cells], comma_likely=False)
    assert (found.kind, found.fault) == ("time", None)
    np.testing.assert_allclose(found.values, since / 1e6, rtol=0, atol=1e-9)


def test_daylight_saving_is_told_by_the_zone() -> None:
    (found,) = convert([["2024-10-27T02:59:59+02:00", "2024-10-27T02:00:00+01:00"]], comma_likely=False)
    assert found.values is not None
    assert found.values.tolist() == [0.0, 1.0]


def test_minutes_and_seconds_as_Excel_shows_them() -> None:
    (found,) = convert([["59:59.5", "00:00.0", "00:00.5"]], comma_likely=False)
    assert found.values is not None
    assert found.values.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("cell", ["2024-13-45 10:00:00", "31.02.2024 10:00:00"])
def test_a_date_that_is_none_is_a_fault(cell: str) -> None:
    (found,) = convert([["2024-01-01 10:00:00", cell]], comma_likely=False)
    assert found.fault is not None


def test_a_version_or_an_address_is_a_text() -> None:
    for cells in (["1.2.3.4", "1.2.3.5"], ["COM3:", "COM4:"], ["a-b-c", "d-e-f"]):
        assert convert([cells], comma_likely=False)[0].kind == "text"


def test_a_row_of_units_that_contradicts_the_names_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,command_mm,angle_deg\nms,mm,deg\n0,1,2\n40,2,3\n")
    with pytest.raises(LogError, match=r"row 2: the unit below 'time_s' is ms, expected s"):
        read_csv(path)
    path.write_text("time_s,command_µm,angle_deg\ns,μm,°\n0,1000,2\n40,2000,3\n")
    assert read_csv(path).command.tolist() == [1.0, 2.0]


def test_a_column_is_found_by_any_preamble_that_has_as_many_cells(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Rate,25,Hz\nMade by,J. Smith,room 3\ntime_s,command,angle_deg\nseconds,mm,deg\n0,1,2\n1,2,3\n")
    columns = read_columns(path)
    assert columns.cells is not None
    assert columns.cells.table.header_row == 3
    assert columns.where(0) == "row 5"
    assert columns.t.tolist() == [0.0, 1.0]


def test_values_lost_for_a_while_are_no_rows_of_another_signal(tmp_path: Path) -> None:
    """A command that is missing for two seconds among complete rows would be held: it is refused instead."""
    path = tmp_path / "log.csv"
    rows = [f"{k / 25},{'' if 30 < k < 80 else k},{2 * k}" for k in range(120)]
    path.write_text("\n".join(["time_s,command,angle_deg", *rows]))
    with pytest.raises(LogError, match=r"row 33, column 'command': got an empty cell, .* \(49 such cells\)"):
        read_csv(path)


@given(
    seed=st.integers(0, 1000),
    fast=st.integers(2, 9),
    slow=st.integers(11, 40),
    shift=st.integers(0, 8),
)
def test_merged_rates_keep_every_sample_of_the_angle(seed: int, fast: int, slow: int, shift: int) -> None:
    """Whatever the two rates: the angle as logged, and the last command before each of its samples."""
    random = np.random.default_rng(seed)
    t_u, t_y = np.arange(0, 400, fast), np.arange(shift + 1, 380, slow)
    u, y = random.random(t_u.size), random.random(t_y.size)
    both = sorted({*t_u.tolist(), *t_y.tolist()})
    commands, angles = (
        dict(zip(t_u.tolist(), u.tolist(), strict=True)),
        dict(zip(t_y.tolist(), y.tolist(), strict=True)),
    )
    lines = ["time_s,command,angle_deg", *(f"{s},{commands.get(s, '')},{angles.get(s, '')}" for s in both)]
    table = text_table(lines, "log.csv")
    assert is_merged(table.numbers["command"], table.numbers["angle_deg"])
    angle = table.numbers["angle_deg"]
    rows, t, command, _ = merged(table.numbers["time_s"], table.numbers["command"], angle, {})
    np.testing.assert_array_equal(t, t_y)
    np.testing.assert_array_equal(angle[rows], y)
    np.testing.assert_array_equal(command, u[np.searchsorted(t_u, t_y, side="right") - 1])
