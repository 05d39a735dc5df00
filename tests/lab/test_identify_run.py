"""The identification study as it really runs, on next to nothing."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from hystmpc.trials.errors import ConfigError
from hystmpc_lab.identify.bars import CONTROLLERS, IdentifyOutcome
from hystmpc_lab.identify.run import prepare_identify, run_identify
from hystmpc_lab.identify.settings import IdentifySettings

pytestmark = pytest.mark.slow
SETTINGS = IdentifySettings.of(quick=True, kind="pi")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, IdentifyOutcome]:
    """Four devices, made in one go."""
    folder = tmp_path_factory.mktemp("identify") / "run"
    return folder, run_identify(prepare_identify(SETTINGS, folder))


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


def test_a_second_call_does_nothing_again(whole: tuple[Path, IdentifyOutcome]) -> None:
    folder, outcome = whole
    study = prepare_identify(SETTINGS, folder)
    assert study.costs == {}
    assert run_identify(study).results == outcome.results


def test_a_folder_of_another_study_is_refused(whole: tuple[Path, IdentifyOutcome], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError):
        prepare_identify(SETTINGS, tmp_path)
