"""Progress of parts told as one: it never goes back, whole parts stand at their share of the time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.types import parts


@given(seconds=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=5), steps=st.integers(1, 9))
def test_parts_are_one_work(seconds: list[float], steps: int) -> None:
    told: list[tuple[float, float, str]] = []
    for part in parts(lambda done, total, note="": told.append((done, total, note)), seconds):
        for k in range(steps + 2):  # one more than there are
            part(k, steps, "note")
    done = [value for value, _, _ in told]
    assert done == sorted(done)
    assert {total for _, total, _ in told} == {sum(seconds)}
    assert {note for _, _, note in told} == {"note"}
    for number in range(len(seconds)):
        assert told[number * (steps + 2) + steps][0] == pytest.approx(sum(seconds[: number + 1]))


def test_nobody_looks() -> None:
    (part,) = parts(None, [1.0])
    part(1, 2)
