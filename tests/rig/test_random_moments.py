"""The campaign of faults at random moments, as short as it can be, and its judge on made-up logs."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc_lab.faults.cases import OVERSHOOT
from hystmpc_lab.faults.judge import rise

from ..conftest import ROOT
from ..scripts import script

MS = 1_000_000


@pytest.mark.slow
def test_each_kind_of_fault_at_a_random_moment(tmp_path: Path) -> None:
    """Real processes and sockets; whoever plays more asks for more: `--moments 200`."""
    out = tmp_path / "moments.json"
    command = [sys.executable, "lab/benchmarks/random_moments.py", "--moments", "1", "--lanes", "3", "--out", out]
    done = subprocess.run([*map(str, command)], cwd=ROOT, capture_output=True, text=True, check=False)
    found = json.loads(out.read_text())
    assert [m["fault"] for m in found] == [""] * 3
    assert {m["kind"] for m in found} == {"kill", "pause", "stall"}
    assert max(m["from_mm"] for m in found) > 1.0
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def moments() -> ModuleType:
    return script("random_moments")


def rows(held: list[float], first_ms: int = 0) -> list[tuple[float, ...]]:
    """A device's log: one sample in 40 ms, in which it got what it holds."""
    return [((first_ms + 40 * k) * MS, 0.04 * k, u, u, 30.0) for k, u in enumerate(held)]


@given(st.lists(st.floats(0, 6), min_size=1, max_size=40))
def test_a_rise_is_the_greatest_way_up_from_the_least_distance_so_far(held: list[float]) -> None:
    pairs = [b - a for k, a in enumerate(held) for b in held[k:]]
    assert rise(held) == pytest.approx(max(0.0, *pairs), abs=1e-12)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ([3.0, 2.0, 1.0, 0.0], ""),
        ([3.4, 3.4 + OVERSHOOT, 2.0, 0.0], ""),
        ([3.4, 4.0, 0.0], "the device rose by 0.60 mm"),
        ([2.0, 0.0, 0.0, 3.0, 0.0], "the device rose by 3.00 mm"),
        ([2.0, 1.0], "the device stays at 1.00 mm"),
    ],
)
def test_where_the_device_goes_after_a_fault_is_judged(
    after: list[float], expected: str, moments: ModuleType, tmp_path: Path
) -> None:
    found = moments.judged("kill", 1.0, rows([2.0, 3.0, *after]), 50 * MS, tmp_path / "no run")
    assert found.fault == expected
    assert found.from_mm == 3.0
    assert math.isinf(found.safe_s) == ("stays" in expected)
