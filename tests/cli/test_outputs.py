"""Nothing that a user has is overwritten: outputs are held against what lies there before any work is done."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hystmpc.models.simulator import export_simulator, save_simulator
from hystmpc.tasks.outputs import EVALUATION, MODEL, SIMULATOR, Output, check_output
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import require_writable
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import require_resumable, require_vacant
from hystmpc.trials.trial import Trial

from ..models.zoo import CHAINS, simulator
from .test_verbs import run

POSIX = pytest.mark.skipif(os.name == "nt", reason="links and permissions are those of POSIX")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of every kind that a user may have."""
    folder = tmp_path_factory.mktemp("made")
    t = np.arange(0, 10, 0.04)
    command = 3 - 3 * np.cos(0.6 * np.pi * t)
    write_csv(Trial(t, command, 20 + 10 * command), folder / "trial.csv")
    save_simulator(simulator(CHAINS["backlash"]), folder / "sim.yaml")
    export_simulator(simulator(CHAINS["backlash"]), folder / "model.onnx")
    (folder / "evaluation.json").write_text(json.dumps({"format": "hystmpc-evaluation/1"}))
    (folder / "bench.yaml").write_text("transport: {kind: udp}\nrate_hz: 25\n")
    (folder / "notes.json").write_text('{"mine": true}')
    (folder / "mapping.yaml").write_text("time: time_s\ncommand: command\nangle: angle_deg\n")
    (folder / "empty.onnx").touch()
    (folder / "mine.html").write_text("<html>my notes</html>")
    Report("page", ()).save(folder / "page.html")
    for name in ("trial.csv.onnx", "trial.csv.json", "trial.csv.yaml"):  # a recording under another ending
        shutil.copy(folder / "trial.csv", folder / name)
    return folder


@pytest.fixture
def desk(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """These files where the command is called, and a run folder."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "trial.csv").write_text("mine")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


EXPORT, FIT = ["export", "sim.yaml", "--out"], ["fit", "backlash", "trial.csv", "--out"]
EVALUATE = ["evaluate", "sim.yaml", "trial.csv", "--json"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        # what the audit destroyed
        ([*EXPORT, "trial.csv"], "expected a file ending in .onnx"),
        ([*EXPORT, "sim.yaml"], "expected a file ending in .onnx"),
        ([*EVALUATE, "trial.csv"], "expected a file ending in .json"),
        ([*FIT, "bench.yaml"], "bench.yaml: exists"),
        # a name that is taken
        ([*EXPORT, "model.onnx"], "model.onnx: exists, expected a new file; --force replaces it if it is an ONNX"),
        ([*EVALUATE, "evaluation.json"], "evaluation.json: exists"),
        ([*FIT, "sim.yaml"], "sim.yaml: exists"),
        (["bench", "--quick", "--json", "notes.json"], "notes.json: exists"),
        ([*FIT, "new.yaml", "--report", "page.html"], "page.html: exists, expected a new file; --force replaces it"),
        (["evaluate", "sim.yaml", "trial.csv", "--report", "mine.html", "--force"], "is not a report of hystmpc"),
        # --force replaces files of the same kind only
        ([*EXPORT, "trial.csv.onnx", "--force"], "is not an ONNX model of hystmpc"),
        ([*EXPORT, "empty.onnx", "--force"], "is not an ONNX model of hystmpc"),
        ([*EVALUATE, "notes.json", "--force"], "is not an evaluation"),
        ([*EVALUATE, "trial.csv.json", "--force"], "is not an evaluation"),
        ([*FIT, "bench.yaml", "--force"], "is not a simulator file"),
        ([*FIT, "trial.csv.yaml", "--force"], "is not a simulator file"),
        ([*FIT, "mapping.yaml", "--layout", "mapping.yaml", "--force"], "is read by the same command"),
        (["bench", "--quick", "--json", "evaluation.json", "--force"], "is not a benchmark's result"),
        # not a place for a file
        ([*EXPORT, "taken"], "expected a file ending in .onnx"),
        ([*EXPORT, "trial.csv/model.onnx"], "cannot be written"),
        ([*EXPORT, "x" * 260 + ".onnx"], "cannot be written"),
        # folders
        (["data", "make", "s1", "--out", "taken"], "is not empty"),
        (["study", "s1", "--quick", "--out", "taken"], "is not empty"),
        (["study", "control", "--quick", "--out", "taken"], "is not empty"),
        (["effects", "--out", "taken"], "is not empty"),
        (["bench", "--quick", "--out", "taken"], "is not empty"),
        (["demo", "--out", "taken"], "is not empty"),
        (["gap", "blind", "make", "--seed", "1", "--out", "taken"], "is not empty"),
        (["gap", "blind", "ablate", "trial.csv", "--sim", "sim.yaml", "--out", "taken"], "is not empty"),
        (["diagnose", "trial.csv", "--sim", "sim.yaml", "--out", "taken"], "is not empty"),
        (["diagnose", "trial.csv", "--sim", "sim.yaml", "--out", "trial.csv"], "is a file"),
        (["effects", "--out", "trial.csv"], "is a file"),
        (["study", "s1", "--quick", "--out", "trial.csv/run"], "cannot be written"),
        (["data", "make", "s1", "--out", "trial.csv/set"], "cannot be written"),
        (["diagnose", "trial.csv", "--sim", "sim.yaml", "--out", "trial.csv/run"], "cannot be written"),
    ],
)
def test_nothing_of_the_users_is_overwritten(
    arguments: list[str], message: str, desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(desk)
    code, _, err = run(capsys, *arguments)
    assert contents(desk) == before
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert (code, len(lines)) == (2, 1), err
    assert message in lines[0]


@pytest.mark.parametrize(
    ("arguments", "file"),
    [
        ([*EXPORT, "model.onnx"], "model.onnx"),
        ([*EVALUATE, "evaluation.json"], "evaluation.json"),
        (["evaluate", "sim.yaml", "trial.csv", "--report", "page.html"], "page.html"),
    ],
)
def test_force_replaces_a_file_of_the_same_kind(
    arguments: list[str], file: str, desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (desk / "model.onnx").unlink()
    export_simulator(simulator(CHAINS["pi"]), desk / "model.onnx")
    before = contents(desk)
    assert run(capsys, *arguments, "--force")[0] == 0
    after = contents(desk)
    assert [name for name in before if after[name] != before[name]] == [file]
    assert sorted(after) == sorted(before)


@pytest.mark.slow
def test_a_fit_with_force_replaces_a_simulator(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (desk / "sim.yaml").read_bytes()
    assert run(capsys, *FIT, "sim.yaml", "--force")[0] == 0
    assert (desk / "sim.yaml").read_bytes() != before


@POSIX
@pytest.mark.parametrize("link", ["symlink", "hard link", "dangling"])
def test_a_recording_behind_a_link_stays(link: str, desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = desk / "e.json"
    if link == "hard link":
        name.hardlink_to(desk / "trial.csv")
    else:
        name.symlink_to(desk / ("trial.csv" if link == "symlink" else "absent"))
    before = contents(desk)
    for extra in ([], ["--force"]):
        assert run(capsys, *EVALUATE, "e.json", *extra)[0] == 2
        assert contents(desk) == before
        assert os.path.lexists(name)


@POSIX
@pytest.mark.parametrize("place", ["/dev/null", "/proc/self/new.json", "/dev/full/x.json"])
def test_what_is_no_place_for_a_file_is_refused_before_any_work(
    place: str, desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, *EVALUATE, place, "--force")
    assert (code, out) == (2, "")
    assert err.startswith("error: --json")


@pytest.mark.skipif(sys.platform != "linux", reason="a place that says it can be written and cannot")
@pytest.mark.parametrize(
    "arguments",
    [
        [*FIT, "/proc/x.yaml"],
        [*FIT, "new.yaml", "--report", "/proc/x.html"],
        [*EXPORT, "/proc/x.onnx"],
        [*EVALUATE, "/proc/x.json"],
        ["diagnose", "trial.csv", "--sim", "sim.yaml", "--out", "/proc/x"],
        ["data", "make", "s1", "--out", "/proc/x"],
        ["study", "s1", "--quick", "--out", "/proc/x"],
        ["commission", "--logs", "trial.csv", "--out", "/proc/x"],
        ["bench", "--quick", "--json", "/proc/x.json"],
        ["gap", "blind", "make", "--seed", "1", "--out", "/proc/x"],
        ["demo", "--out", "/proc/x"],
        ["effects", "--out", "/proc/x"],
        ["faults", "--transport", "udp", "--out", "/proc/x"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_place_that_cannot_be_written_is_found_before_any_work(
    arguments: list[str], desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert [line[:7] for line in err.splitlines()] == ["error: "]
    assert "cannot be written" in err


@POSIX
def test_a_folder_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    real = tempfile.TemporaryFile

    def refused(dir: Path) -> IO[bytes]:  # as for others than root
        if dir == locked:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return real(dir=dir)

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    for path in (locked, locked / "a.json", locked / "a" / "b" / "c.json"):
        with pytest.raises(ConfigError, match=r"Permission denied in .*locked"):
            require_writable(path)
    with pytest.raises(ConfigError, match=r"--json .*Permission denied"):
        check_output("--json", locked / "a.json", (EVALUATION,))
    for check in (require_vacant, require_resumable):
        with pytest.raises(ConfigError, match="Permission denied"):
            check(locked)


@pytest.fixture(scope="module")
def corner(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("corner")
    shutil.copytree(made, folder, dirs_exist_ok=True)
    return folder


NAMES = ["trial.csv", "sim.yaml", "model.onnx", "evaluation.json", "bench.yaml", "notes.json", "empty.onnx", "new.onnx"]
OWN: dict[str, Output] = {"model.onnx": MODEL, "sim.yaml": SIMULATOR, "evaluation.json": EVALUATION}


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from([*NAMES, "new.yaml", "new.json", "trial.csv.onnx", "trial.csv.json", "trial.csv.yaml"]),
    kinds=st.lists(st.sampled_from([MODEL, SIMULATOR, EVALUATION]), min_size=1, max_size=3),
    inputs=st.lists(st.sampled_from(NAMES), max_size=3),
    force=st.booleans(),
)
def test_what_may_be_written_is_new_or_of_its_kind_and_no_input(
    name: str, kinds: list[Output], inputs: list[str], force: bool, corner: Path
) -> None:
    path, suffix = corner / name, Path(name).suffix
    fits = any(suffix in kind.endings for kind in kinds)
    allowed = fits and (not path.exists() or (force and OWN.get(name) in kinds and name not in inputs))
    before = sorted(corner.iterdir())
    with nullcontext() if allowed else pytest.raises(ConfigError, match=r"^--out [^\n]*$"):
        check_output("--out", path, kinds, [corner / other for other in inputs], force)
    assert sorted(corner.iterdir()) == before, "a check makes nothing"
