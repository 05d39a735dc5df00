"""Logs of two axes: read by their columns, refused in a line where the second axis is missing or broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hystmpc
from hystmpc import read_trials
from hystmpc.trials.axes import both_axes, in_channels, pulls
from hystmpc.trials.check import Severity, check
from hystmpc.trials.errors import LogError

HEADER = "time_s,command_x,command_y,angle_x_deg,angle_y_deg"
TENDONS = "time_s,command_1,command_2,command_3,angle_x_deg,angle_y_deg"


def written(path: Path, header: str = HEADER, gap: bool = False) -> Path:
    """A log of two axes."""
    t = 0.04 * np.arange(200)
    rows = np.column_stack([t, np.sin(t), np.cos(t), 10 * np.sin(t), 8 * np.cos(t)])
    lines = [header, *(",".join(f"{x:.6g}" for x in row) for row in rows)]
    if gap:
        lines[50] = lines[50].rpartition(",")[0] + ","
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("header", [HEADER, HEADER.replace("command_x", "command_x_bar").replace("_y,", "_y_bar,", 1)])
def test_a_log_of_two_axes_is_read_by_its_columns(tmp_path: Path, header: str) -> None:
    (trial,) = both_axes(read_trials(written(tmp_path / "log.csv", header), rate_hz=25)) or []
    assert trial.commands.shape == trial.angles.shape == (200, 2)
    t = 0.04 * np.arange(200)
    np.testing.assert_allclose(trial.commands, np.column_stack([np.sin(t), np.cos(t)]), atol=1e-5)
    np.testing.assert_allclose(trial.angles, np.column_stack([10 * np.sin(t), 8 * np.cos(t)]), atol=1e-4)
    assert not trial.channels


def test_a_mapping_file_names_the_second_axis_as_channels(tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv", "t,u1,u2,pitch,yaw")
    mapping = tmp_path / "map.yaml"
    mapping.write_text(
        "time: t\ncommand: {signal: u1, unit: mm}\nangle: {signal: pitch, unit: deg}\n"
        "channels: {command_y: {signal: u2}, angle_y_deg: {signal: yaw}}\n"
    )
    (trial,) = both_axes(read_trials(log, layout=mapping, rate_hz=25)) or []
    assert trial.angles.shape == (200, 2)


def of_tendons(path: Path, header: str = TENDONS, at_deg: tuple[float, ...] = (20.0, 140.0, 260.0)) -> Path:
    """A log of three tendons at these angles, whose device is a line."""
    t, random = 0.04 * np.arange(300), np.random.default_rng(1)
    u = np.column_stack([np.interp(t, np.linspace(0, 12, 25), random.uniform(0, 4, 25)) for _ in at_deg])
    phi = np.deg2rad(at_deg)
    angles = u @ np.column_stack([10 * np.cos(phi), 8 * np.sin(phi)])
    lines = [header, *(",".join(f"{x:.9g}" for x in row) for row in np.column_stack([t, u, angles]))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("header", [TENDONS, TENDONS.replace("command_1", "command_1_bar")])
def test_a_log_of_tendons_is_read_by_its_columns(tmp_path: Path, header: str) -> None:
    (trial,) = both_axes(read_trials(of_tendons(tmp_path / "log.csv", header), rate_hz=25)) or []
    assert (trial.commands.shape, trial.angles.shape) == ((300, 3), (300, 2))
    again = both_axes([in_channels(trial)])
    assert again is not None
    np.testing.assert_array_equal(again[0].commands, trial.commands)


def test_a_mapping_file_names_further_tendons_as_channels(tmp_path: Path) -> None:
    log = of_tendons(tmp_path / "log.csv", "t,a,b,c,pitch,yaw")
    mapping = tmp_path / "map.yaml"
    mapping.write_text(
        "time: t\ncommand: {signal: a, unit: mm}\nangle: {signal: pitch, unit: deg}\n"
        "channels: {command_2: b, command_3: c, angle_y_deg: yaw}\n"
    )
    (trial,) = both_axes(read_trials(log, layout=mapping, rate_hz=25)) or []
    assert trial.commands.shape == (300, 3)


def test_logs_of_other_tendons_are_refused_in_one_line(tmp_path: Path) -> None:
    logs = of_tendons(tmp_path / "three.csv"), of_tendons(tmp_path / "two.csv", TENDONS.replace("command_3", "spare"))
    with pytest.raises(LogError, match="got 2 commands, expected 3 commands as in the other logs") as refused:
        both_axes([trial for log in logs for trial in read_trials(log)])
    assert len(str(refused.value)) <= 300 + len(str(tmp_path))


def test_check_looks_at_the_travels_of_tendons(tmp_path: Path) -> None:
    """No single tendon says where the tip goes; their travels do."""
    report = check(of_tendons(tmp_path / "log.csv"))
    assert not [f for f in report.findings if f.severity in (Severity.ERROR, Severity.WARNING)]
    assert report.of("y: sign")


@given(
    st.lists(st.floats(-180, 180), min_size=3, max_size=9).filter(lambda at: _apart(at) > 0.2),
    st.floats(0.1, 100),
    st.floats(0.1, 100),
)
def test_the_pulls_of_tendons_are_their_directions(at_deg: list[float], gain_x: float, gain_y: float) -> None:
    """Of a line, whatever its gains: row x is along cos phi, row y along sin phi, of length sqrt(2 / n)."""
    u = np.random.default_rng(1).uniform(0, 3, (200, len(at_deg)))
    rows = np.stack([np.cos(np.deg2rad(at_deg)), np.sin(np.deg2rad(at_deg))])
    got = pulls(u, u @ rows.T * [gain_x, gain_y] + 7.0)
    expected = np.sqrt(2 / len(at_deg)) * rows / np.linalg.norm(rows, axis=1, keepdims=True)
    np.testing.assert_allclose(got, expected, atol=1e-6)


def _apart(at_deg: list[float]) -> float:
    """How far tendons are from pulling by one axis alone: 0 to 1."""
    rows = np.stack([np.cos(np.deg2rad(at_deg)), np.sin(np.deg2rad(at_deg))])
    sizes = np.linalg.norm(rows, axis=1)
    return float(sizes.min() / np.sqrt(len(at_deg)))


def test_logs_of_one_axis_stay_as_they_are(tmp_path: Path) -> None:
    one = written(tmp_path / "one.csv", "time_s,command,other,angle_deg,more")
    trials = read_trials(one)
    assert both_axes(trials) is None
    with pytest.raises(LogError, match="got one axis") as refused:
        both_axes([*read_trials(written(tmp_path / "two.csv")), *trials])
    assert len(str(refused.value)) <= 300


def test_a_gap_in_the_second_axis_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="angle_y_deg has no number") as refused:
        both_axes(read_trials(written(tmp_path / "log.csv", gap=True)))
    assert len(str(refused.value)) <= 300


def test_check_looks_at_both_axes(tmp_path: Path) -> None:
    report = check(written(tmp_path / "log.csv", gap=True))
    (finding,) = report.of("y: values")
    assert finding.severity is Severity.ERROR
    assert report.of("sign")
    assert report.of("y: sign")


def test_what_takes_one_axis_refuses_a_log_of_two_in_one_line(tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv")
    for call in (
        lambda: hystmpc.evaluate("builtin:pi", log),
        lambda: hystmpc.diagnose(log, "builtin:pi", out=tmp_path / "out"),
    ):
        with pytest.raises(LogError, match="a log of two axes, expected one") as refused:
            call()
        assert len(str(refused.value)) <= 300 + len(str(log))


@pytest.mark.parametrize("still", [1, 2])
def test_a_log_in_which_one_axis_moves_alone_is_sound(tmp_path: Path, still: int) -> None:
    t = 0.04 * np.arange(400)
    rows = np.column_stack([t, np.sin(t), np.sin(t), 20 * np.sin(t), 20 * np.sin(t)])
    rows[:, still], rows[:, still + 2] = 0.3, 0.2 * np.sin(t)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=HEADER, comments="")
    report = check(tmp_path / "log.csv")
    assert not [f for f in report.findings if f.severity in (Severity.ERROR, Severity.WARNING)]
    rows[:, 1:3] = 0.3
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=HEADER, comments="")
    assert check(tmp_path / "log.csv").worst is Severity.ERROR
