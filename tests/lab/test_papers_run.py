"""Studies that really train, on next to nothing: resuming, failing, several processes, reports."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from hystmpc.sim.jobs.runner import backend_for
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.types import Progress
from hystmpc_lab.papers.job import TrainingJob, TrainingTask
from hystmpc_lab.papers.result import JobResult, StudyOutcome, model_file, result_files
from hystmpc_lab.papers.run import prepare, run_study
from hystmpc_lab.papers.settings import StudySettings
from hystmpc_lab.papers.worker import do_job

from ..trials.test_html import Page
from .study_examples import small_splits

pytestmark = pytest.mark.slow
SETTINGS = StudySettings.for_study(
    "s2", quick=True, kinds=("fnn", "backlash"), directions=("forward",), stages=("main",), betas=(0.0,)
)


def job(**changes: object) -> TrainingJob:
    return replace(TrainingJob("main", "backlash", "paper", "forward", "sin", None, 1, None), **changes)  # type: ignore[arg-type]


def task(**changes: object) -> TrainingTask:
    splits = small_splits()
    return TrainingTask(job(**changes), splits["sin/train"], (), {"sin/test": splits["sin/test"]})


def run_jobs(
    tasks: Sequence[TrainingTask], folder: Path, workers: int = 1, progress: Progress | None = None
) -> tuple[JobResult, ...]:
    return result_files(folder).complete(
        [tasks], partial(do_job, folder=folder), lambda task: task.fingerprint, backend_for(workers), {}, progress
    )


def stable(result: JobResult) -> JobResult:
    """What of a result does not depend on how fast the machine was."""
    return replace(result, seconds=0.0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyOutcome]:
    """A quick study of S2, made in one go."""
    pytest.importorskip("torch", reason="torch is an extra")
    folder = tmp_path_factory.mktemp("study") / "s2"
    return folder, run_study(prepare(SETTINGS, folder))


def tables(folder: Path) -> dict[str, str]:
    """All tables but that of the times."""
    return {path.name: path.read_text() for path in (folder / "tables").glob("*.csv") if path.name != "jobs.csv"}


def test_a_study_leaves_models_results_tables_and_a_report(whole: tuple[Path, StudyOutcome]) -> None:
    folder, outcome = whole
    assert outcome.failed == ()
    assert len(outcome.done) == 2 * 2  # motions and kinds
    assert all(model_file(folder, result.job).exists() for result in outcome.done)
    assert {"config.yaml", "meta.json", "report.html"} <= {path.name for path in folder.iterdir()}
    rows = list(csv.DictReader((folder / "tables" / "errors_forward_sin_paper.csv").open()))
    assert [row["model"] for row in rows] == ["FNN", "backlash"]
    assert float(rows[1]["mean RMSE [deg]"]) < float(rows[0]["mean RMSE [deg]"])


def test_the_report_opens_offline_and_says_what_is_whose(whole: tuple[Path, StudyOutcome]) -> None:
    html = (whole[0] / "report.html").read_text()
    page = Page(html)
    assert page.open == []
    assert not re.search(r"https?://|@import|//cdn", html)
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    text = "".join(page.text)
    assert all(
        part in text for part in ("Figure 8", "Table I", "Figure 5", "Figure 6", "Figure 9", "QUICK", "Simulated")
    )
    assert page.tags.count("svg") == page.tags.count("figure") >= 4
    for name in tables(whole[0]):
        assert name == "per_trial.csv" or f"({name})" in text


def test_resuming_skips_what_is_done(whole: tuple[Path, StudyOutcome]) -> None:
    folder, outcome = whole
    written = {path: path.stat().st_mtime_ns for path in (folder / "models").iterdir()}
    seen: list[str] = []
    again = run_jobs(
        prepare(SETTINGS, folder).ready.jobs, folder, progress=lambda done, total, note="": seen.append(note)
    )
    assert seen == [f"{len(outcome.done)} of {len(outcome.done)} jobs "]
    assert again == outcome.results
    assert {path: path.stat().st_mtime_ns for path in (folder / "models").iterdir()} == written


def test_a_killed_study_resumes_to_the_identical_tables(whole: tuple[Path, StudyOutcome], tmp_path: Path) -> None:
    def stop(done: float, total: float, note: str = "") -> None:
        assert 0 <= done <= total  # expected seconds
        if note.startswith("2 of 4 jobs"):
            raise KeyboardInterrupt

    folder = tmp_path / "s2"
    study = prepare(SETTINGS, folder)
    with pytest.raises(KeyboardInterrupt):
        run_study(study, progress=stop)
    assert len(list((folder / "results").glob("*.json"))) == 2
    assert not (folder / "report.html").exists()
    half = folder / "results" / ".half.json.part"
    half.write_text("{")
    outcome = run_study(prepare(SETTINGS, folder))
    assert not half.exists()
    assert [stable(result) for result in outcome.results] == [stable(result) for result in whole[1].results]
    assert tables(folder) == tables(whole[0])


def test_a_failing_job_is_reported_and_tried_again_and_stops_nothing(tmp_path: Path) -> None:
    """The window study does not know a backlash."""
    tasks = [task(window=5), task()]
    failed, done = run_jobs(tasks, tmp_path)
    assert (failed.status, done.status) == ("failed", "done")
    assert "the window study knows" in failed.message
    assert not model_file(tmp_path, failed.job).exists()
    seen: list[str] = []
    run_jobs(tasks, tmp_path, progress=lambda done, total, note="": seen.append(note))
    assert seen == ["1 of 2 jobs ", f"2 of 2 jobs {failed.job.key} failed"]
    outcome = StudyOutcome(SETTINGS.model_copy(update={"study": "s2"}), small_splits(), (failed, done), tmp_path)
    assert outcome.failed == (failed,)


def test_changed_settings_or_trials_are_computed_anew(tmp_path: Path) -> None:
    first = run_jobs([task()], tmp_path)
    splits = small_splits()
    other = replace(task(), training=splits["p2p/train"])
    second = run_jobs([other], tmp_path)
    assert second[0].fingerprint != first[0].fingerprint
    assert second[0].scores != first[0].scores


def test_two_processes_find_what_one_finds(tmp_path: Path) -> None:
    tasks = [task(), task(kind="pi")]
    alone = run_jobs(tasks, tmp_path / "one")
    both = run_jobs(tasks, tmp_path / "two", 2)
    assert [stable(result) for result in both] == [stable(result) for result in alone]


def test_a_folder_of_something_else_is_refused(whole: tuple[Path, StudyOutcome], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not empty"):
        prepare(SETTINGS, tmp_path)
    copy = shutil.copytree(whole[0], tmp_path / "copy")
    with pytest.raises(ConfigError, match="expected one of study s1"):
        prepare(StudySettings.for_study("s1", quick=True), copy)
    result_files(copy).path(whole[1].done[0].job).write_text("{")
    with pytest.raises(LogError, match="remove it"):
        prepare(SETTINGS, copy)


def test_a_study_of_s1_scans_with_its_own_models(tmp_path: Path) -> None:
    """An operator in the place of the DRDPI: tables, figures and the reconstruction."""
    settings = StudySettings.for_study("s1", quick=True, kinds=("pi",))
    outcome = run_study(prepare(settings, tmp_path / "s1"))
    assert outcome.failed == ()
    names = {path.stem for path in (tmp_path / "s1" / "tables").iterdir()}
    assert names >= {"table_3", "table_4", "reconstruction_errors", "per_trial", "jobs"}
    rows = list(csv.DictReader((tmp_path / "s1" / "tables" / "reconstruction_errors.csv").open()))
    assert {row["model"] for row in rows} == {"PI"}
    assert all(0 < float(row["mean [mm]"]) < 5 for row in rows)
    text = (tmp_path / "s1" / "report.html").read_text()
    assert "Table III" in text
    assert "FAILED" not in text
