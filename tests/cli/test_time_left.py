"""Laws of the time left: near the true one on stages of unequal speed, without jumps, and nothing stands at the end."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.cli.bars import EVEN, RISE_PER_S, Pace, TimeLeft, clock_words
from hystmpc.trials.brief import about

SPEEDS = st.lists(st.floats(0.25, 1.0), min_size=2, max_size=6)  # of stages, four times as fast at most


def shown(seconds: list[float], steps: int, pace: Pace = EVEN, every: float = 0.5) -> list[tuple[float, float, float]]:
    """Time, time left as shown and true time left, of stages that take so many seconds in `steps` steps each."""
    ends = np.concatenate([[0.0], np.cumsum(np.repeat(np.array(seconds) / steps, steps))])
    left, reported, found = TimeLeft(pace), 0, []
    for now in np.arange(0.0, ends[-1], every):
        while reported < ends.size and ends[reported] <= now:
            left.reported(reported / (ends.size - 1), ends[reported])
            reported += 1
        seen = left.seconds(now)
        if seen is not None:
            found.append((float(now), seen, float(ends[-1] - now)))
    return found


@given(speeds=SPEEDS, scale=st.floats(10.0, 60.0), steps=st.integers(5, 40))
def test_stages_of_unequal_speed(speeds: list[float], scale: float, steps: int) -> None:
    """It errs by the factor between the stages' speeds at most, and a margin while it follows; it never jumps up."""
    seconds = [scale / len(speeds) / speed for speed in speeds]
    apart, total = max(speeds) / min(speeds), sum(seconds)
    run = shown(seconds, steps)
    for now, seen, true in run:
        if now > 0.15 * total and true > 0.1 * total:
            assert true / (1.5 * apart) <= seen <= 1.5 * apart * true
    for (before, first, _), (after, then, _) in pairwise(run):
        assert then <= first * (1.0 + 1.01 * RISE_PER_S * (after - before))


@given(speeds=SPEEDS, scale=st.floats(20.0, 60.0))
def test_stages_whose_share_of_the_time_is_known(speeds: list[float], scale: float) -> None:
    """With the measured pace it is right from the first tenth on, whatever the speed of the machine."""
    seconds = [scale / len(speeds) / speed for speed in speeds]
    times = np.concatenate([[0.0], np.cumsum(seconds)]) / sum(seconds)
    pace = list(zip(np.linspace(0.0, 1.0, len(speeds) + 1), times, strict=True))
    for now, seen, true in shown(seconds, 40, pace):
        if now > 0.1 * sum(seconds):
            assert seen == pytest.approx(true, abs=0.05 * sum(seconds) + 1.0)


def test_a_step_that_takes_long_is_waited_for_without_a_jump() -> None:
    """A tenth of the work that takes as long as all before it: it rises slowly, and comes down again."""
    left = TimeLeft()
    for k in range(9):
        left.reported(k / 10, 2.0 * k)
    seen = [left.seconds(16.0 + t) for t in np.arange(0.0, 16.0, 0.5)]
    values = [value for value in seen if value is not None]
    assert len(values) == len(seen)
    assert all(b <= a * 1.011 + 1e-9 for a, b in pairwise(values))
    left.reported(0.9, 32.0)
    assert 0.0 < (left.seconds(33.0) or 0.0) <= 5.0


def test_a_new_count_begins_where_less_is_told() -> None:
    left = TimeLeft()
    left.reported(0.9, 100.0)
    left.reported(0.0, 200.0)
    assert left.seconds(200.5) is None
    left.reported(0.5, 210.0)
    assert left.seconds(210.0) == pytest.approx(10.0)


@given(seconds=st.floats(0.0, 1e5))
def test_words_are_never_less_than_the_time_and_little_more(seconds: float) -> None:
    parts = [int(part) for part in clock_words(seconds).split(":")]
    value = sum(part * 60**k for k, part in enumerate(reversed(parts)))
    assert seconds <= value <= max(seconds + 10.0, math.ceil(seconds))


@given(seconds=st.floats(0.0, 5000.0))
def test_a_duration_in_words_is_near(seconds: float) -> None:
    number, unit = about(seconds).split()
    value = float(number) * {"s": 1.0, "min": 60.0}[unit]
    assert abs(value - seconds) <= max(0.25 * seconds, 1.0)


def test_words() -> None:
    assert [clock_words(s) for s in (None, 0.0, 6.2, 31.0, 152.0, 3700.0)] == [
        "", "0:00", "0:07", "0:35", "2:40", "1:01:40",
    ]  # fmt: skip
