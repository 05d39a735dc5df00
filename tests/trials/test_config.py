"""Configuration: unknown keys get the nearest right name, overrides reach nested keys, every error is one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import Field

from hystmpc.trials.config import Settings, dump_yaml, line_of, load_settings
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


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ("name: first\nloop:\n  rate: 40\n", r"experiment\.yaml, line 3: loop: unknown key 'rate'"),
        ("name: first\nloop:\n\n  # slow\n  rate_hz: -4\n", r"experiment\.yaml, line 5: loop\.rate_hz"),
        ("name: first\nloops: {}\n", r"experiment\.yaml, line 2: top level: unknown key 'loops'"),
        ("loop: {horizon: 2}\n", r"experiment\.yaml: name: Field required"),
        ("name: first\nloop: 3\n", r"experiment\.yaml, line 2: loop"),
    ],
)
def test_an_error_names_the_line(content: str, place: str, path: Path) -> None:
    path.write_text(content)
    with pytest.raises(ConfigError, match=place):
        load_settings(Experiment, path)


def test_an_error_of_an_override_names_the_override_and_no_line(path: Path) -> None:
    with pytest.raises(ConfigError, match=r"experiment\.yaml, --set loop\.rate_hz=-1: loop\.rate_hz"):
        load_settings(Experiment, path, ["name=second", "loop.rate_hz=-1"])


@pytest.mark.parametrize(
    ("at", "line"),
    [
        (("a",), 1),
        (("a", 1), 3),
        (("a", 1, "b"), 4),
        (("a", "tagged-union", 1, "b"), 4),
        (("a", 1, "missing"), 3),
        (("c", "d", 0), 6),
        (("nowhere",), None),
    ],
)
def test_lines_of_entries(at: tuple[str | int, ...], line: int | None) -> None:
    assert line_of("a:\n  - x: 1\n  - y: 2\n    b: 3\n# note\nc: {d: [1, 2]}\n", at) == line
    assert line_of("a: [", at) is None
