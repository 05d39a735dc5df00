"""The self-test recovers what it put in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hystmpc.gap.self_test import CASES, SelfTestRow, motions, record, self_test
from hystmpc.models.effects.catalogue import diagnosable


def test_every_effect_of_the_library_is_a_case() -> None:
    truths = [case.truth for case in CASES.values()]
    assert {name for truth in truths for name in truth} == set(diagnosable())
    assert all((name,) in truths for name in diagnosable())
    assert () in truths
    assert any(len(truth) > 1 for truth in truths)


def test_its_motions_start_at_rest_and_stay_within_the_span() -> None:
    for command in motions(np.random.default_rng(0)):
        assert command[0] == 0.0
        assert command.min() >= 0.0
        assert command.max() <= 6.0


@pytest.mark.parametrize("name", CASES)
def test_each_truth_changes_the_angles(name: str) -> None:
    plain, changed = record(CASES["none"], 5), record(CASES[name], 5)
    differences = [np.abs(b.angle - a.angle).max() for a, b in zip(plain, changed, strict=True)]
    if name == "none":
        assert max(differences) == 0.0
    else:
        assert np.median(differences) > 0.5


def rows_of(names: Sequence[str]) -> tuple[list[tuple[int, int]], tuple[SelfTestRow, ...]]:
    """Progress and rows of some cases."""
    steps: list[tuple[int, int]] = []
    rows = self_test(2, lambda done, total, note="": steps.append((done, total)), names)
    return steps, rows


@pytest.mark.slow
def test_known_truths_are_recovered() -> None:
    names = ("lag", "creep")
    steps, rows = rows_of(names)
    assert steps == [(0, 2), (1, 2), (2, 2)]
    assert [row.name for row in rows] == list(names)
    for row in rows:
        assert row.passed, row
        assert row.truth in row.named.replace("|", ", ").split(", ")
        assert row.closed_share > 0.7
        assert row.seconds > 0
