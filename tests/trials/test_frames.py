"""Trials out of data frames: the columns of a layout, as in a file, told by the real pandas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hystmpc.trials.check import check
from hystmpc.trials.csv_files import FrameLike, read_csv
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units


def frame(**changes: object) -> pd.DataFrame:
    """Six samples in canonical columns, some of them changed; a column that is None is left out."""
    columns = {
        "time_s": 0.04 * np.arange(6),
        "command": [0, 1, 2, 3, 2, 1],
        "angle_deg": [30.0, 31, 35, 40, 39, 36],
        "tension": [1.0, None, 2, 2, 2, 2],
        "source": list("aabbcc"),
    } | changes
    return pd.DataFrame({name: values for name, values in columns.items() if values is not None})


def test_a_frame_reads_as_its_file_does(tmp_path: Path) -> None:
    frame().to_csv(tmp_path / "a.csv", index=False)
    (trial,), from_file = read_trials(frame()), read_csv(tmp_path / "a.csv")
    for name in ("t", "command", "angle"):
        np.testing.assert_array_equal(getattr(trial, name), getattr(from_file, name))
    assert list(trial.channels) == list(from_file.channels) == ["tension"]
    np.testing.assert_array_equal(trial.channels["tension"], from_file.channels["tension"])


def test_time_may_be_the_index() -> None:
    (trial,) = read_trials(frame().set_index("time_s"))
    np.testing.assert_array_equal(trial.t, 0.04 * np.arange(6))


def test_files_frames_and_trials_may_be_mixed(tmp_path: Path) -> None:
    frame().to_csv(tmp_path / "a.csv", index=False)
    one = read_csv(frame())
    read = read_trials([tmp_path, frame(), one], rate_hz=12.5)
    assert [len(trial) for trial in read] == [3, 3, 3]
    assert read_trials(one) == [one]


def test_layouts_are_those_of_files() -> None:
    bar = frame().rename(columns={"command": "command_bar"})
    assert read_csv(bar).units == Units(command="bar")
    lab = frame().rename(columns={"time_s": "Time", "command": "Tendon Disp.", "angle_deg": "Angle x"})
    assert read_csv(lab, "tendon-catheter").command[3] == read_csv(lab).command[3] == 3
    mapping = LogMapping.parse(
        {"time": "Time", "command": {"signal": "Tendon Disp.", "unit": "cm"}, "angle": "Angle x"}
    )
    assert read_trials(lab, mapping)[0].command[3] == 30.0


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"angle_deg": None}, "misses angle_deg"),
        ({"angle_deg": [1, 2, None, 4, 5, 6]}, "row 2, column 'angle_deg': got 'nan', expected a finite number"),
        ({"time_s": [0, 1, 1, 2, 3, 4]}, "row 2, column 'time_s': got 1 s after 1 s"),
        ({"command": list("abcdef")}, "column 'command': got 'a', expected a number"),
    ],
)
def test_what_cannot_be_used_is_named(changes: dict[str, object], expected: str) -> None:
    with pytest.raises(HystmpcError, match="<frame>") as caught:
        read_trials(frame(**changes))
    assert expected in str(caught.value)


def test_odd_frames_are_refused() -> None:
    twice = pd.DataFrame(np.zeros((3, 2)), columns=["time_s", "time_s"])
    for odd, text in ((twice, "occurs twice"), (frame().iloc[:0], "no rows"), (pd.DataFrame(), "no rows")):
        with pytest.raises(HystmpcError, match=text):
            read_trials(odd)


def test_a_check_is_lenient() -> None:
    report = check(frame(angle_deg=[1, 2, None, 4, 5, 6]))
    assert [f.message for f in report.of("values") if f.severity == "error"] == [
        "angle: 1 of 6 not finite, first at row 2"
    ]


def test_what_is_taken_for_a_frame() -> None:
    assert isinstance(frame(), FrameLike)
    assert not isinstance(read_csv(frame()), FrameLike)
    for other in (Path("a.csv"), "a.csv", [frame()], {"time_s": [0.0]}, np.zeros(3)):
        assert not isinstance(other, FrameLike | Trial)
