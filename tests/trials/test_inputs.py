"""Measured inputs of a log: in every format, as a signal or as one number, never silently wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystmpc.trials.check import check
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.layouts import LogMapping, load_mapping
from hystmpc.trials.read import at_rate, read_log, read_trials

from .test_ways import drawn
from .written_ways import MAPPED

T = np.arange(0.0, 12.0, 0.01)


def table(folder: Path, name: str = "seal_3bar.csv", pressure: object = None) -> Path:
    """Log with a further column `p [bar]`, whose cells may be given."""
    u = 2.0 + np.sin(T)
    p = 1.0 + 0.1 * T if pressure is None else pressure
    rows = [f"{a:.2f},{b:.4f},{10 * b:.4f},{c}" for a, b, c in zip(T, u, p, strict=True)]
    (folder / name).write_text("t,u,y,p [bar]\n" + "\n".join(rows) + "\n")
    return folder / name


def mapped(inputs: object) -> LogMapping:
    return LogMapping.parse({"time": "t", "command": "u", "angle": "y", "inputs": inputs})


@pytest.mark.parametrize("way", MAPPED)
def test_an_input_is_read_from_every_format(way: str, tmp_path: Path) -> None:
    t, u, y = drawn(3)
    write, names = MAPPED[way]
    path, command = write(tmp_path, t, u, y), names["command"]
    signal = command if isinstance(command, str) else command["signal"]
    load = {"signal": signal, "scale": 2.0, "offset": 1.0, "hold": True}
    trial = read_log(path, LogMapping.parse({**names, "inputs": {"load": load, "bar": 3}}))
    assert list(trial.inputs) == ["load", "bar"]
    np.testing.assert_allclose(trial.command, u)
    assert np.corrcoef(trial.inputs["load"], u)[0, 1] > 0.999
    assert np.all(trial.inputs["bar"] == 3.0)


def test_an_input_has_the_options_of_a_signal_and_keeps_its_place_at_another_rate(tmp_path: Path) -> None:
    trial = read_log(table(tmp_path), mapped({"pressure_bar": {"signal": "p [bar]", "scale": 100.0, "offset": -1.0}}))
    np.testing.assert_allclose(trial.inputs["pressure_bar"], 99.0 + 10.0 * T)
    (slow,) = at_rate([trial], 25.0)
    np.testing.assert_allclose(slow.inputs["pressure_bar"], 99.0 + 10.0 * slow.t)
    assert not trial.channels


def test_logs_that_differ_by_a_constant_share_one_mapping(tmp_path: Path) -> None:
    logs = [table(tmp_path, f"seal_{bar}bar.csv") for bar in (1, 3)]
    (tmp_path / "map.yaml").write_text(
        "{time: t, command: u, angle: y, inputs: {pressure_bar: {by_file: {'*_1bar.csv': 1.0, '*_3bar.csv': 3}}}}"
    )
    trials = read_trials(logs, load_mapping(tmp_path / "map.yaml"))
    assert [set(trial.inputs["pressure_bar"].tolist()) for trial in trials] == [{1.0}, {3.0}]


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"p": "pres"}, "no signal 'pres'"),
        ({"p": {"by_file": {"other*": 1.0}}}, "0 patterns of `by_file` fit"),
        ({"p": {"by_file": {"seal*": 1.0, "*3bar*": 3.0}}}, "2 patterns of `by_file` fit"),
        ({"p": {"value": 1.0, "signal": "u"}}, "expected one of `signal: NAME`"),
        ({"p": {}}, "expected one of `signal: NAME`"),
        ({"p": float("nan")}, "finite"),
        ({f"p{k}": 1.0 for k in range(7)}, "at most 6"),
    ],
)
def test_a_wrong_input_is_one_line(inputs: object, words: str, tmp_path: Path) -> None:
    with pytest.raises(HystmpcError, match=words) as refused:
        read_log(table(tmp_path), mapped(inputs))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) <= 300


def test_a_gap_in_an_input_is_named_and_check_says_what_it_reads(tmp_path: Path) -> None:
    mapping = mapped({"pressure_bar": "p [bar]"})
    report = check(table(tmp_path), mapping)
    assert [str(f.message) for f in report.of("input")] == ["pressure_bar: 1 to 2.199, 1.6 in the mean"]
    gap = ["" if 300 <= k < 310 else "1.5" for k in range(T.size)]
    path = table(tmp_path, "gap.csv", gap)
    with pytest.raises(HystmpcError, match=r"pressure_bar is nan at sample 300, .*10 such"):
        read_log(path, mapping)
    assert "pressure_bar: 10 of 1200 not finite" in str(check(path, mapping))


def test_a_channel_becomes_an_input_by_its_name(tmp_path: Path) -> None:
    names = {"time": "t", "command": "u", "angle": "y", "channels": {"p": "p [bar]"}}
    trial = read_log(table(tmp_path), LogMapping.parse(names))
    assert list(trial.with_inputs(["p"]).inputs) == ["p"]
    assert not trial.with_inputs(["p"]).channels
    with pytest.raises(HystmpcError, match="no input 'q'"):
        trial.with_inputs(["q"])
