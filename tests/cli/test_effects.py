"""`hystmpc effects` lists the library, and says it in JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.trials.errors import ConfigError

RUN = CliRunner()


def test_the_table_names_every_effect_with_its_parameters() -> None:
    text = RUN.invoke(app, ["effects"]).stdout
    assert all(name in text for name in EFFECTS)
    assert "share [1] -3 to 0.95, neutral 0" in text


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match="is a file, expected a new or empty folder"):
        RUN.invoke(app, ["effects", "--out", str(tmp_path / "file")], catch_exceptions=False)


def test_the_library_in_json() -> None:
    data = json.loads(RUN.invoke(app, ["effects", "--json"]).stdout)
    assert [entry["name"] for entry in data] == list(EFFECTS)
    assert all(p["lower"] < p["upper"] for entry in data for p in entry["parameters"])
