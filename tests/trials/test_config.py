"""Configuration: unknown keys get the nearest right name, overrides reach nested keys, every error is one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import Field

from hystmpc.trials.config import Settings, dump_yaml, load_settings
from hystmpc.trials.errors import ConfigError


class Loop(Settings):
    rate_hz: float = Field(50.0, gt=0)
    horizon: int = 10


class Experiment(Settings):
    name: str
    loop: Loop = Loop()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "experiment.yaml"
    file.write_text("name: first\nloop:\n  rate_hz: 40\n")
    return file


def test_defaults_file_and_overrides_add_up(path: Path) -> None:
    settings = load_settings(Experiment, path, ["loop.horizon=25", "name=second"])
    assert settings.model_dump() == {"name": "second", "loop": {"rate_hz": 40.0, "horizon": 25}}


def test_settings_survive_yaml(path: Path) -> None:
    settings = load_settings(Experiment, path)
    path.write_text(dump_yaml(settings.model_dump(mode="json")))
    assert load_settings(Experiment, path) == settings


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["loop.rate=3"], ["experiment.yaml", "loop", "'rate'", "available: horizon, rate_hz; did you mean 'rate_hz'"]),
        (["loops.rate_hz=3"], ["'loops'", "did you mean 'loop'"]),
        (["loop.rate_hz=-1"], ["loop.rate_hz", "greater than 0", "got -1"]),
        (["loop.rate_hz=.inf"], ["loop.rate_hz", "finite", "inf"]),
        (["loop.rate_hz=fast"], ["loop.rate_hz", "number", "'fast'"]),
        (["name.first=1"], ["--set name.first=1", "'name' is a value"]),
        (["loop.rate_hz"], ["--set loop.rate_hz", "KEY.KEY=VALUE"]),
        (["loop.rate_hz=[1"], ["--set loop.rate_hz=[1", "not a YAML value"]),
    ],
)
def test_wrong_overrides_are_answered_in_one_line(path: Path, overrides: list[str], parts: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load_settings(Experiment, path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    assert all(part in text for part in parts), text


@pytest.mark.parametrize(
    ("content", "part"),
    [(b"name: [", "line"), (b"- 1\n", "got list"), (b"", "got NoneType"), (b"\xff\xfe\x00", "cannot be read")],
)
def test_unreadable_files_are_named(content: bytes, part: str, tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=rf"broken\.yaml.*{part}"):
        load_settings(Experiment, file)
    with pytest.raises(ConfigError, match=r"absent\.yaml"):
        load_settings(Experiment, tmp_path / "absent.yaml")
