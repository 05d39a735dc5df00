"""Logs that users of the field could not read: what each gives now. They are beside the checkout, never in it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hystmpc.cli.main import main
from hystmpc.trials.errors import LogError
from hystmpc.trials.read import read_log


@pytest.fixture
def cases() -> Path:
    data = os.environ.get("HYSTMPC_DATA", Path(__file__).parents[3] / "shared" / "data")
    found = Path(data).parent / "field_cases"
    if not found.is_dir():
        pytest.skip("the cases of the field are not beside this checkout")
    return found


@pytest.mark.parametrize(
    ("log", "layout", "samples"),
    [
        ("05-text-columns/iso.csv", "", 1500),
        ("05-text-columns/date_ms.csv", "", 1500),
        ("05-text-columns/date_ms.csv", "05-text-columns/map_time.yaml", 1500),
        ("05-text-columns/quoted_decimal_comma.csv", "", 1500),
        ("06-merged-rates/merged.csv", "", 1194),
        ("06-merged-rates/merged.csv", "06-merged-rates/map.yaml", 1194),
        ("07-lvm-utf16-preamble/preamble.csv", "", 1499),
        ("07-lvm-utf16-preamble/units_row.csv", "", 1499),
        ("07-lvm-utf16-preamble/utf16.csv", "", 1499),
        ("10-mat-layouts/rows.mat", "10-mat-layouts/map_rows.yaml", 1000),
        ("10-mat-layouts/dspace.mat", "10-mat-layouts/map_dspace.yaml", 1000),
    ],
)
def test_a_log_of_the_field_is_read(log: str, layout: str, samples: int, cases: Path) -> None:
    trial = read_log(cases / log, str(cases / layout) if layout else "auto")
    assert len(trial) == samples
    assert 0.4 < trial.command.min() < trial.command.max() < 5.6
    assert 16 < trial.angle.min() < trial.angle.max() < 72


def test_whole_seconds_can_be_replaced_by_a_rate(cases: Path) -> None:
    path = cases / "05-text-columns/date.csv"
    with pytest.raises(LogError, match=r"1440 such rows\); if it was sampled evenly, `--sampled-hz 2\d"):
        read_log(path)
    assert len(read_log(path, sampled_hz=25)) == 1500


def test_a_line_of_json_is_named(cases: Path) -> None:
    with pytest.raises(LogError, match="JSON, which is not read; export the table as CSV"):
        read_log(cases / "11-one-line-json/one_line.json")


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    monkeypatch.setattr("sys.argv", ["hystmpc", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], "too slow for the default of 25 Hz, expected at most 15 Hz (1.5 times its own rate); add `--rate-hz 10`"),
        (["--rate-hz", "40"], "too slow for 40 Hz, expected at most 15 Hz"),
    ],
)
def test_an_error_names_a_rate_only_if_it_was_given(
    options: list[str],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time_s,command,angle_deg", *(f"{k / 10},{k % 7},{k % 5}" for k in range(99))]))
    run(monkeypatch, "fit", "pi", str(path), "--out", str(tmp_path / "m.yaml"), *options)
    said = capsys.readouterr().err
    assert expected in said
    assert ("default" in said) is not bool(options)
