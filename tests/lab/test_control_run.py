"""The closed-loop benchmark as it really runs, on next to nothing."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from hystmpc.trials.errors import ConfigError
from hystmpc_lab.control.bars import ControlOutcome
from hystmpc_lab.control.report import runs_table
from hystmpc_lab.control.run import prepare_control, run_control
from hystmpc_lab.control.settings import ControlSettings

pytestmark = pytest.mark.slow
SETTINGS = ControlSettings.of(
    quick=True, plants=("backlash",), motions=("point_to_point",), controllers=("inverse", "linearised_backlash")
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ControlOutcome]:
    """One plant, one motion, two controllers at 25 Hz, made in one go."""
    folder = tmp_path_factory.mktemp("control") / "run"
    return folder, run_control(prepare_control(SETTINGS, folder))


def test_it_leaves_results_signals_tables_and_a_report(whole: tuple[Path, ControlOutcome]) -> None:
    folder, outcome = whole
    assert outcome.failed == ()
    assert [run.job.subject for run in outcome.runs] == ["inverse", "linearised_backlash"]
    assert all(run.figures["violations"] == 0 for run in outcome.runs)
    rows = list(csv.DictReader((folder / "tables" / "bars.csv").open()))
    assert rows[0]["bar"] == "hold error, exactly known plant [deg]"
    assert float(rows[0]["worst"]) < 0.05
    assert rows[0]["verdict"] == "met"
    plain = json.loads((folder / "tables" / "control.json").read_text())
    assert len(plain["runs"]) == 2
    html = (folder / "report.html").read_text()
    assert not re.search(r"https?://|@import|//cdn", html)
    assert "QUICK" in html
    assert html.count("<svg") >= 2


def test_a_second_call_does_nothing_again(whole: tuple[Path, ControlOutcome]) -> None:
    folder, outcome = whole
    study = prepare_control(SETTINGS, folder)
    assert study.costs == {}
    seen: list[str] = []
    again = run_control(study, progress=lambda done, total, note="": seen.append(note))
    assert seen == ["3 of 3 jobs "]
    assert again.results == outcome.results


def test_an_interrupted_one_goes_on_to_the_same_figures(whole: tuple[Path, ControlOutcome], tmp_path: Path) -> None:
    def stop(done: float, total: float, note: str = "") -> None:
        if note.startswith("2 of 3 jobs"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_control(prepare_control(SETTINGS, tmp_path / "run"), progress=stop)
    assert not (tmp_path / "run" / "report.html").exists()
    study = prepare_control(SETTINGS, tmp_path / "run")
    assert len(study.costs) == 1
    again = run_control(study)

    def steady(outcome: ControlOutcome) -> list[list[object]]:
        """Rows without the share of late steps, which the machine decides."""
        table = runs_table(outcome)
        late = list(table.columns).index("late steps (not judged)")
        return [[cell for k, cell in enumerate(row) if k != late] for row in table.rows]

    assert steady(again) == steady(whole[1])


def test_a_folder_of_another_study_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not empty"):
        prepare_control(SETTINGS, tmp_path)
