"""The bar of a diagnosis: whatever the number of rounds, each moves it, and it never goes back."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.diagnose import _selection_progress


@given(rounds=st.integers(1, 12), candidates=st.integers(2, 40))
def test_every_round_moves_the_bar(rounds: int, candidates: int) -> None:
    told: list[float] = []
    advance = _selection_progress(lambda done, total, note="": told.append(done))
    for _ in range(rounds):
        for k in range(candidates):
            advance(k / candidates, "lag/command")
    assert told == sorted(told)
    assert told[0] >= 5
    assert told[-1] < 85
    ends = told[candidates - 1 :: candidates]
    assert all(after - before > 0.3 * (85 - before) for before, after in pairwise(ends))
