"""Every study as it really runs, on the least that can break it: results, tables and a page that opens offline."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from hystmpc_lab.commission.settings import CommissionStudySettings
from hystmpc_lab.commission.settings import bars as commission_bars
from hystmpc_lab.commission.study import STUDY as COMMISSION
from hystmpc_lab.control.settings import ControlSettings
from hystmpc_lab.control.study import STUDY as CONTROL
from hystmpc_lab.identify.settings import CONTROLLERS, IdentifySettings
from hystmpc_lab.identify.study import STUDY as IDENTIFY
from hystmpc_lab.papers.job import PaperOutcome, TrainingJob, TrainingTask, model_file
from hystmpc_lab.papers.settings import PaperSettings
from hystmpc_lab.papers.study import STUDIES
from hystmpc_lab.study import Study

from ..trials.test_html import Page
from .study_examples import small_splits

pytestmark = pytest.mark.slow

LOOPS = ("inverse", "linearised_backlash")
S2 = PaperSettings.for_study(
    "s2", quick=True, kinds=("fnn", "backlash"), directions=("forward",), stages=("main",), betas=(0.0,)
)
SMALLEST: dict[str, tuple[Study[Any, Any, Any], Any]] = {
    "control": (
        CONTROL,
        ControlSettings.of(
            quick=True,
            plants=("backlash",),
            motions=("point_to_point",),
            controllers=LOOPS,
        ),
    ),
    "identify": (IDENTIFY, IdentifySettings.of(quick=True, kind="pi", evaluations=10)),
    "commission": (COMMISSION, CommissionStudySettings.of(devices=1, seed=3, quick=True, evaluations=10)),
    "s1": (STUDIES["s1"], PaperSettings.for_study("s1", quick=True, kinds=("backlash",))),
    "s2": (STUDIES["s2"], S2),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Folder and outcome of a study by its name, made once."""

    @cache
    def made(name: str) -> tuple[Path, Any]:
        if name == "s2":
            pytest.importorskip("torch", reason="torch is an extra")
        study, settings = SMALLEST[name]
        folder = tmp_path_factory.mktemp(name) / "run"
        return folder, study.begin(settings, folder).finish()

    return made


def rows_of(folder: Path, table: str) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "tables" / f"{table}.csv").open()))


@pytest.mark.parametrize("name", SMALLEST)
def test_it_leaves_results_tables_and_a_page_that_opens_offline(name: str, whole: Any) -> None:
    folder, outcome = whole(name)
    assert outcome.failed == (), [result.message for result in outcome.failed]
    assert {"config.yaml", "meta.json", "report.html"} <= {path.name for path in folder.iterdir()}
    html = (folder / "report.html").read_text()
    page = Page(html)
    assert page.open == []
    assert not re.search(r"https?://|@import|//cdn", html)
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert page.tags.count("svg") == page.tags.count("figure") >= 1
    text = "".join(page.text)
    assert "QUICK" in text
    assert "FAILED" not in text


def test_a_loop_on_the_exact_plant_holds_still(whole: Any) -> None:
    folder, outcome = whole("control")
    assert [run.job.subject for run in outcome.runs] == list(LOOPS)
    assert all(run.figures["violations"] == 0 for run in outcome.runs)
    first = rows_of(folder, "bars")[0]
    assert (first["bar"], first["verdict"]) == ("hold error, exactly known plant [deg]", "met")
    assert float(first["worst"]) < 0.05
    assert len(json.loads((folder / "tables" / "control.json").read_text())["runs"]) == 2


def test_a_device_of_every_family_is_identified_and_controlled(whole: Any) -> None:
    folder, outcome = whole("identify")
    assert {result.facts["family"] for result in outcome.done} == {"rod", "capstan", "dahl", "muscle"}
    for result in outcome.done:
        assert all(result.figures[f"{name}.violations"] == 0 for name in CONTROLLERS)
        assert result.figures["exact.rmse_deg"] < result.figures["pid.rmse_deg"]
    assert len(list((folder / "models").glob("*.yaml"))) == 8
    assert rows_of(folder, "bars")[0]["bar"] == "ratio to the best tuned rival: median"
    assert len(json.loads((folder / "tables" / "identify.json").read_text())["devices"]) == 4


def test_one_device_from_the_bench_to_the_table(whole: Any) -> None:
    """A device with nothing to compare with: commissioned, changed, without a sensor; nothing beyond a limit."""
    _, outcome = whole("commission")
    judged = {bar.name: bar for bar in commission_bars(outcome)}
    assert judged["samples beyond a limit, all controllers"].value == 0
    assert judged["samples stopped by a controller that learns"].value == 0
    assert math.isfinite(judged["commissioned, over the best tuned rival: worst"].value)  # quick: how good says nothing
    assert judged["device time of a commissioning [s]"].state == "met"


def test_models_and_errors_of_s2(whole: Any) -> None:
    folder, outcome = whole("s2")
    assert len(outcome.done) == 2 * 2  # motions and kinds
    assert all(model_file(folder, result.job).exists() for result in outcome.done)
    rows = rows_of(folder, "errors_forward_sin_paper")
    assert [row["model"] for row in rows] == ["FNN", "backlash"]
    assert float(rows[1]["mean RMSE [deg]"]) < float(rows[0]["mean RMSE [deg]"])
    html = (folder / "report.html").read_text()
    assert all(part in html for part in ("Figure 8", "Table I", "Figure 5", "Figure 6", "Figure 9", "Simulated"))
    assert html.count("<svg") >= 4
    names = {path.name for path in (folder / "tables").glob("*.csv")} - {"jobs.csv", "per_trial.csv"}
    assert all(f"({name})" in html for name in names)


def test_a_study_of_s1_scans_with_its_own_models(whole: Any) -> None:
    """An operator in the place of the DRDPI: tables, figures and the reconstruction."""
    folder, _ = whole("s1")
    names = {path.stem for path in (folder / "tables").iterdir()}
    assert names >= {"table_3", "table_4", "reconstruction_errors", "per_trial", "jobs"}
    rows = rows_of(folder, "reconstruction_errors")
    assert {row["model"] for row in rows} == {"backlash"}
    assert all(0 < float(row["mean [mm]"]) < 5 for row in rows)
    assert "Table III" in (folder / "report.html").read_text()


def job(**changes: object) -> TrainingJob:
    return replace(TrainingJob("main", "backlash", "paper", "forward", "sin", None, 1, None), **changes)  # type: ignore[arg-type]


def task(**changes: object) -> TrainingTask:
    splits = small_splits()
    return TrainingTask(job(**changes), splits["sin/train"], (), {"sin/test": splits["sin/test"]})


def test_a_window_that_a_kind_does_not_have_is_told_and_leaves_no_model(tmp_path: Path) -> None:
    """The window study does not know a backlash."""
    failed = STUDIES["s2"].do(task(window=5), S2, tmp_path)
    assert failed.status == "failed"
    assert "the window study knows" in failed.message
    assert not model_file(tmp_path, failed.job).exists()
    assert PaperOutcome(S2, (failed,), tmp_path, {}, small_splits()).failed == (failed,)


def test_other_trials_are_another_result(tmp_path: Path) -> None:
    first = STUDIES["s2"].do(task(), S2, tmp_path)
    other = STUDIES["s2"].do(replace(task(), training=small_splits()["p2p/train"]), S2, tmp_path)
    assert (first.status, first.samples) == ("done", 500)
    assert other.fingerprint != first.fingerprint
    assert other.scores != first.scores
