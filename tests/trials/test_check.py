"""The quality check: every fault that is put into a clean log is found under its topic, and nothing else is."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hystmpc.trials.check import Severity, check
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import LogError
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units

OK, NOTE, WARNING, ERROR = Severity
TOPICS = {
    "values", "time base", "jitter", "gaps", "duplicates", "stuck samples", "units of command", "units of angle",
    "sign", "excitation", "segments", "first flexure",
}  # fmt: skip


def clean(**changes: np.ndarray | Units) -> Trial:
    """A rest of 1 s at 0 mm, two cycles of 0.2 Hz up to 6 mm at 50 Hz, and a rest of 1 s; no hysteresis."""
    t = np.arange(600) / 50
    command = np.where((t >= 1) & (t < 11), 3 - 3 * np.cos(2 * np.pi * 0.2 * (t - 1)), 0.0)
    values = {"t": t, "command": command, "angle": 30 + 10 * command} | changes
    return Trial(**values)


def broken(change: Callable[[list[str]], None], tmp_path: Path) -> Path:
    """The clean log with changed lines; line k is row k + 1."""
    path = write_csv(clean(), tmp_path / "log.csv")
    lines = path.read_text().splitlines()
    change(lines)
    path.write_text("\n".join(lines))
    return path


def test_a_clean_trial_has_nothing_but_good_news() -> None:
    report = check(clean())
    assert {f.topic for f in report.findings} == TOPICS
    assert report.worst is OK, report.findings
    assert report.of("time base")[0].message == "50 Hz (median), 11.98 s, 600 samples"
    counts = r"2 loading \((5|4\.9)\S* s\), 2 unloading \((5|4\.9)\S* s\), 2 hold \(2\S* s\)"
    assert re.fullmatch(counts, report.of("segments")[0].message)
    assert report.of("excitation")[0].message.startswith("3 reversals")
    assert "10 deg per mm (correlation 1.00)" in report.of("sign")[0].message


def test_file_and_memory_get_the_same_findings(tmp_path: Path) -> None:
    path = write_csv(clean(), tmp_path / "log.csv")
    assert check(path).findings == check(clean()).findings
    assert (check(path).layout, check(path).source) == ("canonical", str(path))


def _set(index: int, column: int, text: str) -> Callable[[list[str]], None]:
    def change(lines: list[str]) -> None:
        cells = lines[index].split(",")
        cells[column] = text
        lines[index] = ",".join(cells)

    return change


FILE_FAULTS = {
    "nan": (_set(100, 2, "nan"), "values", "angle: 1 of 600 not finite, first at row 101"),
    "inf": (_set(100, 1, "-inf"), "values", "command: 1 of 600 not finite, first at row 101"),
    "empty": (_set(100, 1, ""), "values", "command: 1 of 600 not finite, first at row 101"),
    "repeat": (lambda lines: lines.insert(50, lines[49]), "duplicates", "repeat the one before, first at row 51"),
    "backwards": (_set(50, 0, "0.93"), "duplicates", "1 time stamps run backwards, first at row 51"),
    "gap": (lambda lines: lines.__delitem__(slice(100, 150)), "gaps", "the longest 1.02 s from 1.96 s (row 100)"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "topic", "text"), FILE_FAULTS.values(), ids=FILE_FAULTS)
def test_what_a_reader_refuses_becomes_a_finding(
    change: Callable[[list[str]], None], topic: str, text: str, tmp_path: Path
) -> None:
    report = check(broken(change, tmp_path))
    (finding,) = report.of(topic)
    assert finding.severity is ERROR
    assert text in finding.message
    others = {f.topic for f in report.findings if f.severity is ERROR} - {topic, "segments"}
    assert not others


def signals() -> dict[str, tuple[Trial, str, Severity, str]]:
    base = clean()
    u, y, t = base.command, base.angle, base.t
    noise = np.random.default_rng(0).normal(size=u.size)
    late = t >= 6
    high = np.where(t > 3.5, np.maximum(u, 1.5), u)  # after the first crest it never comes back below 1.5 mm
    return {
        "metres": (clean(command=u / 1000), "units of command", WARNING, "looks like metres"),
        "micrometres": (clean(command=u * 1000), "units of command", WARNING, "looks like micrometres"),
        "kPa": (clean(command=u * 50, units=Units("bar")), "units of command", WARNING, "looks like kPa"),
        "offset": (clean(command=u + 500), "units of command", WARNING, "offset or another unit"),
        "radians": (clean(angle=np.radians(y)), "units of angle", WARNING, "looks like radians"),
        "a still tip": (clean(angle=30.05 + 0.001 * y), "units of angle", OK, "30.08 to 30.14 deg"),
        "no motion": (clean(angle=0 * y + 30), "excitation", ERROR, "the angle is 30 deg throughout"),
        "microseconds": (clean(t=1e6 * t), "time base", ERROR, "is it in microseconds? A mapping file with"),
        "epoch": (clean(t=1.7e12 + 1000 * t), "time base", ERROR, "from 1700000000000 to 1700000011980"),
        "too short": (clean().select(0, 49), "length", ERROR, "49 usable samples, expected at least 50"),
        "sign": (clean(angle=90 - 10 * u), "sign", WARNING, "the angle falls as the command rises"),
        "unrelated": (clean(angle=40 + noise), "sign", WARNING, "hardly follows"),
        "constant": (clean(command=0 * u + 2), "excitation", ERROR, "the command is 2 mm throughout"),
        "one way": (clean(command=t, angle=10 * t), "excitation", WARNING, "0 reversals"),
        "milliseconds": (clean(t=1000 * t), "time base", ERROR, "is it in milliseconds?"),
        "jitter": (clean(t=t + 0.006 * np.sin(7 * np.arange(t.size))), "jitter", NOTE, "standard deviation"),
        "stuck": (clean(angle=np.where((t > 2) & (t < 3), 50, y)), "stuck samples", NOTE, "from 2.02 to 2.98 s"),
        "set": (clean(angle=y + 12 * late), "first flexure", WARNING, "is 42 deg after it: a set of +12 deg"),
        "no return": (clean(command=high), "first flexure", NOTE, "does not rest again at 0 mm, where it began"),
    }  # fmt: skip


SIGNALS = signals()


@pytest.mark.parametrize(("trial", "topic", "severity", "text"), SIGNALS.values(), ids=SIGNALS)
def test_a_fault_of_the_signals_is_found(trial: Trial, topic: str, severity: Severity, text: str) -> None:
    (finding,) = check(trial).of(topic)
    assert finding.severity is severity
    assert text in finding.message


def test_a_channel_with_holes_is_only_a_note() -> None:
    current = np.ones(600)
    current[7] = np.nan
    trial = Trial(clean().t, clean().command, clean().angle, {"current": current})
    (finding,) = check(trial).of("values")
    assert (finding.severity, finding.message) == (NOTE, "current: 1 of 600 not finite, first at sample 7")


def test_a_log_without_any_usable_sample_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,command,angle_deg\n" + "nan,nan,nan\n" * 5)
    report = check(path)
    assert report.worst is ERROR
    assert report.findings[-1].message == "0 usable samples, expected at least 50"


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        check(tmp_path / "absent.csv")


def test_the_real_logs_that_never_rest_tell_no_set(real_logs: list[Path]) -> None:
    for path in real_logs:
        report = check(path)
        (flexure,) = report.of("first flexure")
        assert {f.topic for f in report.findings if f.severity is not OK} == {"jitter", "first flexure"}
        assert "a set cannot be told: the command does not rest before it" in flexure.message


def test_an_angle_whose_sensor_has_steps_is_no_stuck_one(tmp_path: Path) -> None:
    trial = clean()
    coarse = check(clean(angle=np.round(trial.angle / 2) * 2))
    assert "its sensor reads in steps of 2" in coarse.of("stuck samples")[0].message
    assert coarse.of("stuck samples")[0].severity is OK


def test_a_log_that_is_written_on_change_only_is_called_so() -> None:
    t = np.arange(4000) / 50
    command = 3 + 2 * np.sin(0.5 * np.pi * np.floor(t / 4) + 0.5 * np.pi * np.minimum(t % 4, 2) / 2)  # moves 2 s in 4
    moves = (t % 4) < 2
    (gaps,) = check(Trial(t[moves], command[moves], 30 + 10 * command[moves])).of("gaps")
    assert gaps.severity is ERROR
    assert "it was recorded on change only" in gaps.message


def test_keys_of_a_mapping_read_what_the_check_has_named(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    t, whole = clean().t, np.rint(clean().command * 100 - 250)
    log, layout = tmp_path / "log.csv", tmp_path / "map.yaml"
    written = np.where(whole < 0, 2.0**15 - whole, whole)
    written[random.choice(np.arange(20, 580), 4, replace=False)] = 999999
    stamps = (40_000 + np.rint(1000 * t)) % 2**14
    rows = zip(stamps, clean().command, written, strict=True)
    log.write_text("ms,u,counts\n" + "".join(f"{a:.0f},{b:.6f},{c:.0f}\n" for a, b, c in rows))

    def read(more: str, time: str = "") -> str:
        signals = (
            f"{{command: {{signal: u}}, angle: {{signal: counts, unit: count{more}}}, time: ms, time_unit: ms{time}}}"
        )
        layout.write_text(signals)
        return str(check(log, str(layout)))

    said = read("")
    assert "time_wraps_at: 16384, time_unit: ms" in said
    assert "missing: [999999]" in said
    assert "sign_bit: 15" in said
    again = read(", missing: [999999], sign_bit: 15", ", time_wraps_at: 16384")
    assert "numbers of" not in again
    assert "time increases from sample to sample" in again
    (trial,) = read_trials(log, str(layout))
    assert len(trial) == 596
    assert trial.duration_s == pytest.approx(11.98)
    shifted = read(", missing: [999999], sign_bit: 15, shift_s: -0.5", ", time_wraps_at: 16384")
    assert "numbers of" not in shifted
    (early,) = read_trials(log, str(layout))
    assert early.t[0] == pytest.approx(trial.t[0])
    assert np.argmax(early.angle) == pytest.approx(np.argmax(trial.angle) - 25, abs=2)
