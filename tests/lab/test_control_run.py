"""The closed-loop benchmark as it really runs, on next to nothing."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from hystmpc_lab.control.bars import ControlOutcome
from hystmpc_lab.control.settings import ControlSettings
from hystmpc_lab.control.study import STUDY

pytestmark = pytest.mark.slow
SETTINGS = ControlSettings.of(
    quick=True, plants=("backlash",), motions=("point_to_point",), controllers=("inverse", "linearised_backlash")
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ControlOutcome]:
    """One plant, one motion, two controllers at 25 Hz, made in one go."""
    folder = tmp_path_factory.mktemp("control") / "run"
    return folder, STUDY.begin(SETTINGS, folder).finish()


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
