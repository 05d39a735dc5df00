"""The engine of all studies, on a study of next to nothing: resuming, failing, stages, processes, refusals, bars."""

from __future__ import annotations

import json
import math
import shutil
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.errors import ConfigError, LogError
from hystmpc_lab.page import Bar, Figures, Rate, by_device, cell, over
from hystmpc_lab.study import Outcome, wall_minutes

sys.path.append(str(Path(__file__).parent))  # which worker processes inherit
sums = import_module("sums_study")
STUDY, SumJob, SumResult, SumSettings, costs = sums.STUDY, sums.SumJob, sums.SumResult, sums.SumSettings, sums.costs
SETTINGS = SumSettings.of()


def stable(outcome: Outcome[SumSettings, SumResult]) -> list[SumResult]:
    """What of the results does not depend on the machine's speed; NaN, which differs from itself, as text."""
    return [replace(r, seconds=0.0, figures={k: repr(v) for k, v in r.figures.items()}) for r in outcome.results]  # type: ignore[misc]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome[SumSettings, SumResult]]:
    folder = tmp_path_factory.mktemp("study") / "sums"
    return folder, STUDY.begin(SETTINGS, folder).finish()


def test_a_study_leaves_results_tables_data_and_a_report(whole: tuple[Path, Outcome[SumSettings, SumResult]]) -> None:
    folder, outcome = whole
    assert {path.name for path in folder.iterdir()} >= {"config.yaml", "meta.json", "report.html", "results", "tables"}
    assert outcome.failed == ()
    assert [r.drawn for r in outcome.done] == [10, 11, 12, 10]
    assert outcome.results[-1].figures["total"] == 16.5
    assert json.loads((folder / "tables" / "sums.json").read_text()) == {"drawn": [10, 11, 12]}
    assert json.loads((folder / "results" / "sum-0.json").read_text())["figures"] == {"total": 16.5, "missing": None}
    assert (folder / "tables" / "figures.csv").read_text().splitlines()[-1] == "sum-0,missing,-"
    assert "QUICK" not in (folder / "report.html").read_text()


def test_a_second_call_does_nothing_twice(whole: tuple[Path, Outcome[SumSettings, SumResult]]) -> None:
    folder, outcome = whole
    written = {path: path.stat().st_mtime_ns for path in (folder / "results").iterdir()}
    begun, seen = STUDY.begin(SETTINGS, folder), list[str]()
    assert begun.costs == {}
    assert begun.minutes(1) == 0
    second = begun.finish(progress=lambda done, total, note="": seen.append(note))
    assert seen == ["4 of 4 jobs "]
    assert stable(second) == stable(outcome)
    assert {path: path.stat().st_mtime_ns for path in (folder / "results").iterdir()} == written


def test_an_interrupted_study_resumes_to_the_identical_tables(
    whole: tuple[Path, Outcome[SumSettings, SumResult]], tmp_path: Path
) -> None:
    def stop(done: float, total: float, note: str = "") -> None:
        assert 0 <= done <= total  # expected seconds
        if note.startswith("2 of 4 jobs"):
            raise KeyboardInterrupt

    folder = tmp_path / "sums"
    with pytest.raises(KeyboardInterrupt):
        STUDY.begin(SETTINGS, folder).finish(progress=stop)
    assert len(list((folder / "results").glob("*.json"))) == 2
    assert not (folder / "report.html").exists()
    half = folder / "results" / ".half.json.part"
    half.write_text("{")
    begun = STUDY.begin(SETTINGS, folder)
    assert len(begun.costs) == 2
    assert begun.minutes(1) == 2
    assert stable(begun.finish()) == stable(whole[1])
    assert not half.exists()
    for table in ("figures.csv", "sums.json"):
        assert (folder / "tables" / table).read_text() == (whole[0] / "tables" / table).read_text()


def test_a_failing_job_is_reported_and_tried_again_and_stops_nothing(tmp_path: Path) -> None:
    broken = SumSettings.of(broken=1)
    outcome = STUDY.begin(broken, tmp_path).finish()
    assert [(r.job.key, r.message, r.drawn) for r in outcome.failed] == [("half-1", "cannot be halved", 11)]
    assert "FAILED: half-1: cannot be halved" in (tmp_path / "report.html").read_text()
    seen: list[str] = []
    STUDY.begin(broken, tmp_path).finish(progress=lambda done, total, note="": seen.append(note))
    assert seen == ["3 of 4 jobs ", "4 of 4 jobs half-1 failed"]


def test_what_depends_on_changed_settings_or_files_is_done_anew(tmp_path: Path) -> None:
    first = STUDY.begin(SETTINGS, tmp_path).finish()
    (tmp_path / "0.txt").write_text("50.0")
    assert list(STUDY.begin(SETTINGS, tmp_path).costs) == ["sum-0"]
    second = STUDY.begin(SumSettings.of(seed=2), tmp_path)
    assert len(second.costs) == 4
    assert second.finish().results[-1].figures["total"] == 31.5 != first.results[-1].figures["total"]


@pytest.mark.slow
def test_two_processes_find_what_one_finds(whole: tuple[Path, Outcome[SumSettings, SumResult]], tmp_path: Path) -> None:
    assert stable(STUDY.begin(SETTINGS, tmp_path / "two").finish(2)) == stable(whole[1])


def test_a_folder_of_something_else_is_refused(
    whole: tuple[Path, Outcome[SumSettings, SumResult]], tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not empty"):
        STUDY.begin(SETTINGS, tmp_path)
    copy = shutil.copytree(whole[0], tmp_path / "copy")
    with pytest.raises(ConfigError, match="holds a run of sums, expected one of study others"):
        replace(STUDY, name="others").begin(SETTINGS, copy)
    (copy / "results" / "half-0.json").write_text("{}")
    with pytest.raises(LogError, match="remove it"):
        STUDY.begin(SETTINGS, copy)


def test_the_costliest_job_of_a_stage_comes_first(tmp_path: Path) -> None:
    dear, seen = replace(STUDY, costs=lambda jobs, settings: {job.key: float(job.number) for job in jobs}), list[str]()
    dear.begin(SETTINGS, tmp_path).finish(progress=lambda done, total, note="": seen.append(note))
    keys = ["", "half-2", "half-1", "half-0", "sum-0"]
    assert seen == [f"{k} of 4 jobs {key}" for k, key in enumerate(keys)]


@pytest.mark.parametrize(
    "text",
    ["{", '{"format": "hystmpc-sums-job/1"}', '{"format": "other/1", "job": {"stage": "sum", "number": 0}}', "[]"],
)
def test_a_damaged_result_is_named(tmp_path: Path, text: str) -> None:
    files = STUDY.files(tmp_path)
    path = files.path(SumJob("sum", 0))
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(LogError, match=r"sum-0\.json.*remove it"):
        files.load(SumJob("sum", 0))


def test_the_wall_time_is_never_less_than_the_longest_job() -> None:
    assert wall_minutes({"a": 600.0, "b": 60.0}, 8) == 10
    assert wall_minutes({"a": 60.0, "b": 60.0}, 2) == 1
    assert wall_minutes({}, 2) == 0


def test_results_survive_their_file(tmp_path: Path) -> None:
    files, result = STUDY.files(tmp_path), SumResult(SumJob("sum", 0), "abc", "done", "", 1.0, 5, {"a": math.nan})
    files.save(result)
    loaded = files.load(result.job)
    assert loaded is not None
    assert math.isnan(loaded.figures["a"])
    assert replace(loaded, figures={}) == replace(result, figures={})


def test_settings_keep_defaults_for_what_is_not_given() -> None:
    assert SumSettings.of(count=None, quick=True).count == 2
    assert SumSettings.of(count=5, quick=True).count == 5
    with pytest.raises(ConfigError, match="study sums"):
        SumSettings.of(count=0)


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.floats(0.01, 1.0))
def test_an_order_statistic_leaves_its_share_of_the_devices_no_greater(values: list[float], level: float) -> None:
    figures: Figures = {str(k): value for k, value in enumerate(values)}
    bar = Bar.at_most("bar", figures, 5.0, level)
    assert sum(value <= bar.value for value in values) >= level * len(values)
    assert bar.value in values
    assert set(bar.misses) == {name for name, value in figures.items() if value > 5.0}
    assert Bar.at_most("worst", figures, 5.0).value == max(values)


def test_a_bar_says_whether_it_is_met_and_who_is_against_it() -> None:
    assert Bar.at_most("lost", {"a": math.inf, "b": 0.1}, 1.0).state == "missed"
    share = Bar.share("share", {"a": True, "b": False}, (0.4, 1.0))
    assert (share.value, share.state, share.misses, share.goal) == (0.5, "met", ("b",), ">= 0.4")
    assert Bar.share("invented", {"a": True, "b": False}, (0.0, 0.05), counted=True).misses == ("a",)
    assert Bar.share("nobody", {}, (0.4, 1.0)).state == "not measured"
    assert Bar.none("stops", {"a": 0.0, "b": 2.0}).misses == ("b",)
    assert Bar("open", math.nan, (0.0, 1.0), 3).plain["value"] is None
    low, high = Rate(1, 2).ci90
    assert low < 0.5 < high


def test_a_ratio_to_what_is_missing_is_infinite() -> None:
    figures = {"a.rmse_deg": 1.0, "b.rmse_deg": 2.0, "c.rmse_deg": 4.0}
    assert over("a", "b", "c")(figures) == 0.5
    assert by_device({"x": figures, "y": {}}, over("a", "b")) == {"x": 0.5, "y": math.inf}
    assert [cell(v) for v in (1.5, math.nan, math.inf)] == [1.5, "-", "infinite"]
