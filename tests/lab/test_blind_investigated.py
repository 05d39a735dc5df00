"""Investigations of blind devices: their device plays what it is asked, their score counts exact names."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from hystmpc.bench import round_plan
from hystmpc.gap.next.motion_design import SearchSettings
from hystmpc_lab.blind.investigated import (
    ScoredInvestigation,
    investigate_blind,
    named_right,
    scored_investigations,
    time_share,
)
from hystmpc_lab.blind.make import make_blind

ONE = ScoredInvestigation("001", "lag", 4.0, "named", ("lag",), 50.0, 200.0)


def test_only_the_cause_alone_is_right() -> None:
    two, wrong, either = (
        replace(ONE, said=("lag", "creep")),
        replace(ONE, said=("creep",)),
        replace(ONE, verdict="one_of"),
    )
    assert [one.right for one in (ONE, two, wrong, either)] == [True, False, False, False]
    assert named_right((ONE, two, wrong, either)).value == 0.25
    assert time_share((ONE, replace(ONE, device_s=100.0))) == pytest.approx(0.375)


@pytest.mark.slow
def test_a_device_is_investigated_and_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One case: device time within the minutes, the result beside the sealed truth, nothing done twice."""
    monkeypatch.setattr("hystmpc.gap.report.page.write_report", lambda *arguments: None)  # figures that take seconds
    monkeypatch.setattr(round_plan, "SearchSettings", partial(SearchSettings, generations=1))
    make_blind(tmp_path, 1806000, 1, "single")
    assert investigate_blind(tmp_path, minutes=0.9, least=0.0) == 0
    found = scored_investigations(tmp_path)
    assert found
    assert all(0 < one.device_s <= 54.0 < one.battery_s for one in found)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "investigations").rglob("investigation.json")}
    assert investigate_blind(tmp_path, minutes=0.9, least=0.0) == 0
    assert before == {
        path: path.stat().st_mtime_ns for path in (tmp_path / "investigations").rglob("investigation.json")
    }
