"""The identification study as it really runs, on next to nothing."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from hystmpc_lab.identify.settings import CONTROLLERS, IdentifyOutcome, IdentifySettings
from hystmpc_lab.identify.study import STUDY

pytestmark = pytest.mark.slow
SETTINGS = IdentifySettings.of(quick=True, kind="pi")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, IdentifyOutcome]:
    """Four devices, made in one go."""
    folder = tmp_path_factory.mktemp("identify") / "run"
    return folder, STUDY.begin(SETTINGS, folder).finish()


def test_it_leaves_results_models_tables_and_a_report(whole: tuple[Path, IdentifyOutcome]) -> None:
    folder, outcome = whole
    assert outcome.failed == ()
    assert {result.facts["family"] for result in outcome.done} == {"rod", "capstan", "dahl", "muscle"}
    for result in outcome.done:
        assert all(result.figures[f"{name}.violations"] == 0 for name in CONTROLLERS)
        assert result.figures["exact.rmse_deg"] < result.figures["pid.rmse_deg"]
    assert len(list((folder / "models").glob("*.yaml"))) == 8
    rows = list(csv.DictReader((folder / "tables" / "bars.csv").open()))
    assert rows[0]["bar"] == "ratio to the best tuned rival: median"
    assert len(json.loads((folder / "tables" / "identify.json").read_text())["devices"]) == 4
    html = (folder / "report.html").read_text()
    assert not re.search(r"https?://|@import|//cdn", html)
    assert "QUICK" in html
    assert "<svg" in html
