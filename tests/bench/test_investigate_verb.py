"""`hystmpc investigate` as a user calls it: what is said beforehand, what is refused, and how a safe stop ends it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hystmpc.trials.config import dump_yaml

from ..cli.test_verbs import run
from .small_investigate import bench


def written(folder: Path, **changes: object) -> Path:
    file = folder / "bench.yaml"
    file.write_text(dump_yaml(bench(**changes) | {"latch_file": "latch.json"}))
    return file


def test_the_plan_is_said_and_nothing_is_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The example, from the repository."""
    example = Path(__file__).resolve().parents[2] / "examples" / "investigate.yaml"
    code, said, _ = run(capsys, "investigate", example, "--dry-run", "--minutes", "4", "--out", tmp_path / "run")
    assert code == 0
    words = " ".join(said.split())
    assert "round 1" in words
    assert "all at most 4.0" in words
    assert "every motion starts and ends at 0 mm" in words
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["bench"], "lacks --out"),
        (["bench", "--minutes", "31", "--out", "run"], "less than or equal to 30"),
        (["bench", "--minutes", "0.2", "--out", "run"], "more minutes"),
        (["bench", "--model", "none.yaml", "--out", "run"], "none.yaml"),
    ],
)
def test_what_is_refused_is_one_line(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"bench": written(tmp_path), "run": tmp_path / "run"}
    code, _, said = run(capsys, "investigate", *(places.get(text, text) for text in arguments))
    assert code == 2
    assert expected in " ".join(said.split())
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_safe_stop_keeps_the_device_latched_and_ends_with_three(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A play wider than what the watch on motion allows: the tip looks blocked."""
    plant = {"simulator": "builtin:tendon-catheter", "lag_s": 2.0, "noise_deg": 0.1}
    stuck = written(tmp_path, transport={"kind": "simulated", "plant": plant}, plausibility={"travel": 2.5})
    code, _, said = run(capsys, "investigate", stuck, "--out", tmp_path / "run")
    assert code == 3
    assert "implausible" in " ".join(said.split())
    assert "--reset goes on" in " ".join(said.split())
    code, _, said = run(capsys, "investigate", stuck, "--out", tmp_path / "run")
    assert code == 2
    assert "latched" in " ".join(said.split())
