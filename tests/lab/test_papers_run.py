"""Studies that really train, on next to nothing: models, tables, reports; what fails."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import pytest

from hystmpc_lab.papers.job import PaperOutcome, TrainingJob, TrainingTask, model_file
from hystmpc_lab.papers.settings import PaperSettings
from hystmpc_lab.papers.study import STUDIES

from ..trials.test_html import Page
from .study_examples import small_splits

pytestmark = pytest.mark.slow
SETTINGS = PaperSettings.for_study(
    "s2", quick=True, kinds=("fnn", "backlash"), directions=("forward",), stages=("main",), betas=(0.0,)
)


def job(**changes: object) -> TrainingJob:
    return replace(TrainingJob("main", "backlash", "paper", "forward", "sin", None, 1, None), **changes)  # type: ignore[arg-type]


def task(**changes: object) -> TrainingTask:
    splits = small_splits()
    return TrainingTask(job(**changes), splits["sin/train"], (), {"sin/test": splits["sin/test"]})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PaperOutcome]:
    """A quick study of S2, made in one go."""
    pytest.importorskip("torch", reason="torch is an extra")
    folder = tmp_path_factory.mktemp("study") / "s2"
    return folder, STUDIES["s2"].begin(SETTINGS, folder).finish()


def tables(folder: Path) -> dict[str, str]:
    """All tables but that of the times."""
    return {path.name: path.read_text() for path in (folder / "tables").glob("*.csv") if path.name != "jobs.csv"}


def test_a_study_leaves_models_results_tables_and_a_report(whole: tuple[Path, PaperOutcome]) -> None:
    folder, outcome = whole
    assert outcome.failed == ()
    assert len(outcome.done) == 2 * 2  # motions and kinds
    assert all(model_file(folder, result.job).exists() for result in outcome.done)
    assert {"config.yaml", "meta.json", "report.html"} <= {path.name for path in folder.iterdir()}
    rows = list(csv.DictReader((folder / "tables" / "errors_forward_sin_paper.csv").open()))
    assert [row["model"] for row in rows] == ["FNN", "backlash"]
    assert float(rows[1]["mean RMSE [deg]"]) < float(rows[0]["mean RMSE [deg]"])


def test_the_report_opens_offline_and_says_what_is_whose(whole: tuple[Path, PaperOutcome]) -> None:
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


def test_a_window_that_a_kind_does_not_have_is_told_and_leaves_no_model(tmp_path: Path) -> None:
    """The window study does not know a backlash."""
    failed = STUDIES["s2"].do(task(window=5), SETTINGS, tmp_path)
    assert failed.status == "failed"
    assert "the window study knows" in failed.message
    assert not model_file(tmp_path, failed.job).exists()
    assert PaperOutcome(SETTINGS, (failed,), tmp_path, {}, small_splits()).failed == (failed,)


def test_other_trials_are_another_result(tmp_path: Path) -> None:
    first = STUDIES["s2"].do(task(), SETTINGS, tmp_path)
    other = STUDIES["s2"].do(replace(task(), training=small_splits()["p2p/train"]), SETTINGS, tmp_path)
    assert (first.status, first.samples) == ("done", 500)
    assert other.fingerprint != first.fingerprint
    assert other.scores != first.scores


def test_a_study_of_s1_scans_with_its_own_models(tmp_path: Path) -> None:
    """An operator in the place of the DRDPI: tables, figures and the reconstruction."""
    settings = PaperSettings.for_study("s1", quick=True, kinds=("pi",))
    outcome = STUDIES["s1"].begin(settings, tmp_path / "s1").finish()
    assert outcome.failed == ()
    names = {path.stem for path in (tmp_path / "s1" / "tables").iterdir()}
    assert names >= {"table_3", "table_4", "reconstruction_errors", "per_trial", "jobs"}
    rows = list(csv.DictReader((tmp_path / "s1" / "tables" / "reconstruction_errors.csv").open()))
    assert {row["model"] for row in rows} == {"PI"}
    assert all(0 < float(row["mean [mm]"]) < 5 for row in rows)
    text = (tmp_path / "s1" / "report.html").read_text()
    assert "Table III" in text
    assert "FAILED" not in text
