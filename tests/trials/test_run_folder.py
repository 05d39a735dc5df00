"""A run on disk: nothing is overwritten, what is written reads back, and the MCAP log agrees with the CSV log."""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from hystmpc.trials import mcap_
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import FORMAT, RunFolder, alone_in, resumed_folder
from hystmpc.trials.tables import read_table


class Loop(Settings):
    rate_hz: float = 50.0


COLUMNS = {
    "time_s": np.arange(4) / 50,
    "command_bar": [0.0, 0.1, 0.2, 0.1 + 0.2],
    "angle_deg": [30.0, 30.5, np.pi, 31.0],
    "predicted_deg": [np.nan, 30.4, 30.9, 31.1],
    "source": ["mpc", "mpc", "hold", "stop, at once"],
    "saturated": np.array([True, False, False, True]),
}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    file = tmp_path / "model.onnx"
    file.write_bytes(b"weights")
    return file


def test_a_run_reads_back(tmp_path: Path, model: Path) -> None:
    run = RunFolder.create(
        tmp_path / "runs" / "a", Loop(), seed=7, models=[model], command_line=["hystmpc", "simulate"]
    )
    run.write_log(COLUMNS)
    run.write_report(Report("done", ()))

    back = RunFolder.open(run.path)
    assert back == run
    assert back.config() == {"rate_hz": 50.0}
    log = back.log()
    assert list(log) == list(COLUMNS)
    for name, values in COLUMNS.items():
        np.testing.assert_array_equal(log[name], values)
    trial = back.trial()
    assert trial.units.command == "bar"
    np.testing.assert_array_equal(trial.command, COLUMNS["command_bar"])
    assert list(trial.channels) == ["predicted_deg", "saturated"]
    assert (run.path / "report.html").read_text() == Report("done", ()).html()


def test_meta_says_what_is_needed_to_repeat_the_run(tmp_path: Path, model: Path) -> None:
    RunFolder.create(tmp_path / "a", {"k": 1}, seed=7, models=[model], command_line=["x"])
    meta = json.loads((tmp_path / "a" / "meta.json").read_text())
    assert (meta["format"], meta["seed"], meta["command_line"]) == (FORMAT, 7, ["x"])
    assert meta["models"] == {str(model): hashlib.sha256(b"weights").hexdigest()}
    assert meta["versions"]["numpy"] == np.__version__
    assert set(meta["versions"]) == {"python", "hystmpc", "numpy", "casadi", "onnxruntime", "osqp"}
    assert datetime.fromisoformat(meta["start"]).utcoffset().total_seconds() == 0
    assert meta["host"]


def test_a_run_is_never_overwritten(tmp_path: Path) -> None:
    RunFolder.create(tmp_path / "a", {})
    before = {file: file.read_bytes() for file in (tmp_path / "a").iterdir()}
    with pytest.raises(ConfigError, match=r"a: holds a run \(config\.yaml, meta\.json\), expected a new"):
        RunFolder.create(tmp_path / "a", {"other": 1})
    assert {file: file.read_bytes() for file in (tmp_path / "a").iterdir()} == before


def test_an_empty_folder_will_do_but_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    RunFolder.create(tmp_path / "empty", {})
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("x")
    with pytest.raises(ConfigError, match=r"is not empty \(chapter\.tex\)"):
        RunFolder.create(tmp_path / "thesis", {})
    with pytest.raises(ConfigError, match="is a file"):
        RunFolder.create(tmp_path / "thesis" / "chapter.tex", {})
    with pytest.raises(ConfigError, match=r"cannot be written"):
        RunFolder.create(tmp_path / "thesis" / "chapter.tex" / "run", {})


def test_a_missing_model_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.onnx"):
        RunFolder.create(tmp_path / "a", {}, models=[tmp_path / "absent.onnx"])
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "no readable meta.json"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "format None"),
        ('{"format": "hystmpc-run/9"}', "hystmpc-run/9"),
    ],
)
def test_what_is_no_run_is_refused(content: str | None, text: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "meta.json").write_text(content)
    with pytest.raises(LogError, match=text):
        RunFolder.open(tmp_path)


@pytest.mark.parametrize(
    ("change", "text"),
    [({"angle_deg": [1.0, 2.0]}, "different lengths"), ({"angle_deg": None}, "log lacks angle_deg")],
)
def test_a_wrong_log_is_refused_whole(change: dict[str, list[float] | None], text: str, tmp_path: Path) -> None:
    columns = {name: values for name, values in (COLUMNS | change).items() if values is not None}
    run = RunFolder.create(tmp_path / "a", {})
    with pytest.raises(LogError, match=text):
        run.write_log(columns)
    assert sorted(file.name for file in run.path.iterdir()) == ["config.yaml", "meta.json"]


def test_the_mcap_log_holds_the_same_samples(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="mcap (extra `logs`) is not installed")
    run = RunFolder.create(tmp_path / "a", {})
    run.write_log(COLUMNS)
    start_ns = round(1e9 * datetime.fromisoformat(run.meta["start"]).timestamp())
    with (run.path / "log.mcap").open("rb") as file:
        messages = list(reader.make_reader(file).iter_messages(topics=[mcap_.TOPIC]))
    assert len(messages) == 4
    for k, (schema, channel, message) in enumerate(messages):
        assert (schema.encoding, channel.message_encoding, message.sequence) == ("jsonschema", "json", k)
        assert message.log_time == start_ns + 20_000_000 * k
        sample = json.loads(message.data)
        assert list(sample) == list(COLUMNS) == list(json.loads(schema.data)["properties"])
        assert sample["command_bar"] == COLUMNS["command_bar"][k]
        assert sample["source"] == COLUMNS["source"][k]
    assert json.loads(messages[0][2].data)["predicted_deg"] is None


def test_a_column_of_dashes_in_a_log_of_ours_is_text() -> None:
    """`-` stands for no fault, and an empty cell for no number."""
    lines = ["time_s,command,faults,frame_s", "0,1,-,", "0.1,2,-,nan", "0.2,3,-,"]
    table = read_table(lines, "log.csv")
    assert table.texts == {"faults": ("-", "-", "-")}
    assert set(table.numbers) == {"time_s", "command", "frame_s"}


def test_a_folder_goes_on_or_says_why_not(tmp_path: Path) -> None:
    first = resumed_folder(tmp_path / "run", {"a": 1}, 0, lambda before: "never asked")
    again = resumed_folder(tmp_path / "run", {"a": 2}, 0, lambda before: "" if before == {"a": 1} else "changed")
    assert again.meta == first.meta
    assert again.config() == {"a": 2}
    with pytest.raises(ConfigError, match="run: another plan"):
        resumed_folder(tmp_path / "run", {}, 0, lambda before: "another plan")


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with alone_in(tmp_path), pytest.raises(ConfigError, match="expected to be alone"), alone_in(tmp_path):
        pass
    with alone_in(tmp_path):
        pass
