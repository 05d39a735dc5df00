"""Results of a study's jobs, on jobs that cost nothing: what is kept, done again and counted."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pytest

from hystmpc.sim.jobs.backend import InTurn
from hystmpc.trials.errors import LogError
from hystmpc_lab.study import ResultFiles, Status, wall_minutes


@dataclass(frozen=True)
class Made:
    """A file that holds a number; the second stage adds up those of the first."""

    key: str
    value: int = 0


@dataclass(frozen=True)
class Found:
    """What became of it."""

    job: Made
    fingerprint: str
    status: Status
    sizes: tuple[int, ...] = field(default=())


def fingerprint(job: Made, folder: Path) -> str:
    made = sorted(folder.glob("a*.txt")) if job.key.startswith("sum") else []
    return json.dumps([job.value, *(path.read_text() for path in made)])


def do(job: Made, folder: Path, calls: list[str]) -> Found:
    calls.append(job.key)
    files = ResultFiles(folder, Found, "toy/1")
    if job.value < 0:
        return Found(job, fingerprint(job, folder), "failed")
    mark = fingerprint(job, folder)
    if not job.key.startswith("sum"):
        (folder / f"{job.key}.txt").write_text(str(job.value))
    found = Found(job, mark, "done", (job.value,))
    files.save(found)
    return found


def run(folder: Path, *stages: list[Made], told: Callable[[str], None] = lambda note: None) -> list[str]:
    """Keys in the order in which they were done."""
    calls: list[str] = []
    ResultFiles(folder, Found, "toy/1").complete(
        stages,
        partial(do, folder=folder, calls=calls),
        partial(fingerprint, folder=folder),
        InTurn(),
        {job.key: float(job.value) for stage in stages for job in stage},
        lambda done, total, note="": told(note),
    )
    return calls


def test_the_costliest_comes_first_and_nothing_is_done_twice(tmp_path: Path) -> None:
    stages = [Made("a1", 1), Made("a2", 2)], [Made("sum", 9)]
    notes: list[str] = []
    assert run(tmp_path, *stages, told=notes.append) == ["a2", "a1", "sum"]
    assert notes == ["0 of 3 jobs ", "1 of 3 jobs a2", "2 of 3 jobs a1", "3 of 3 jobs sum"]
    assert run(tmp_path, *stages) == []


def test_a_changed_job_makes_those_that_read_its_files_out_of_date(tmp_path: Path) -> None:
    run(tmp_path, [Made("a1", 1), Made("a2", 2)], [Made("sum")])
    notes: list[str] = []
    assert run(tmp_path, [Made("a1", 5), Made("a2", 2)], [Made("sum")], told=notes.append) == ["a1", "sum"]
    assert notes == ["2 of 3 jobs ", "3 of 3 jobs a1", "3 of 3 jobs sum"]


def test_failed_jobs_and_half_files_are_done_again(tmp_path: Path) -> None:
    notes: list[str] = []
    assert run(tmp_path, [Made("a1", -1)], told=notes.append) == ["a1"]
    assert notes[-1] == "1 of 1 jobs a1 failed"
    half = tmp_path / "results" / ".a1.json.part"
    half.parent.mkdir(exist_ok=True)
    half.write_text("{")
    assert run(tmp_path, [Made("a1", -1)]) == ["a1"]
    assert not half.exists()


def test_ctrl_c_keeps_what_is_done(tmp_path: Path) -> None:
    def stop(note: str) -> None:
        if note.startswith("1 of"):
            raise KeyboardInterrupt

    jobs = [Made("a1", 1), Made("a2", 2), Made("a3", 3)]
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, jobs, told=stop)
    assert run(tmp_path, jobs) == ["a2", "a1"]


@pytest.mark.parametrize("text", ["{", '{"format": "toy/1"}', '{"format": "other/1", "job": {"key": "a1"}}', "[]"])
def test_a_damaged_result_is_named(tmp_path: Path, text: str) -> None:
    files = ResultFiles(tmp_path, Found, "toy/1")
    path = files.path(Made("a1"))
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(LogError, match=r"a1\.json.*remove it"):
        files.load(Made("a1"))


def test_the_wall_time_is_never_less_than_the_longest_job() -> None:
    assert wall_minutes({"a": 600.0, "b": 60.0}, 8) == 10
    assert wall_minutes({"a": 60.0, "b": 60.0}, 2) == 1
    assert wall_minutes({}, 2) == 0
