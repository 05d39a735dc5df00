"""Property tests draw the same examples on every run, whatever else has been imported."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

RARE = [911_735_001 + 7919 * k for k in range(200)]


def drawn() -> list[int]:
    """The examples of one property test."""
    seen: list[int] = []

    @settings(max_examples=200)
    @given(st.integers())
    def collect(number: int) -> None:
        seen.append(number)

    collect()
    return seen


def test_examples_do_not_depend_on_imported_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "constants_of_a_local_module.py").write_text(f"NUMBERS = {RARE}\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = drawn()
    importlib.import_module("constants_of_a_local_module")
    after = drawn()
    sys.modules.pop("constants_of_a_local_module")
    assert len(before) >= 200
    assert after == before
