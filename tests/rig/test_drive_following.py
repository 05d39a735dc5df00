"""A device that does not hold what it was sent is found; one that is slow is left alone."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.safety.plausibility import DriveFollowing

DT_NS = 40_000_000
WINDOW = 12  # samples in 0.5 s


def judged(held: list[float], sent: list[float], tolerance: float | None = 0.1) -> list[tuple[bool, str]]:
    """One verdict a sample; `held[k]` is what the device says when `sent[k]` was sent last."""
    judge = DriveFollowing(tolerance, 0.5)
    return [judge.judge(h, u, k * DT_NS) for k, (h, u) in enumerate(zip(held, sent, strict=True))]


@given(st.lists(st.floats(0, 6), min_size=30, max_size=80), st.integers(0, WINDOW))
def test_a_device_that_is_late_by_less_than_the_window_follows(sent: list[float], late: int) -> None:
    held = [sent[max(k - late, 0)] for k in range(len(sent))]
    assert all(follows and not dead for follows, dead in judged(held, sent))


def test_a_device_that_no_command_reaches_stops_the_run_within_two_windows() -> None:
    sent = [min(0.2 * k, 6.0) for k in range(60)]
    verdicts = judged([0.0] * 60, sent)
    first = next(k for k, (follows, _) in enumerate(verdicts) if not follows)
    dead = next(k for k, (_, cause) in enumerate(verdicts) if cause)
    assert WINDOW < first <= WINDOW + 3
    assert first + WINDOW <= dead <= first + WINDOW + 2
    assert "holds 0, sent were" in verdicts[dead][1]


def test_a_device_that_holds_more_than_was_sent_does_not_follow_either() -> None:
    """Towards the patient it is the dangerous side."""
    sent = [max(6.0 - 0.2 * k, 0.0) for k in range(60)]
    dead = [cause for _, cause in judged([6.0] * 60, sent) if cause]
    assert "holds 6, sent were" in dead[0]


def test_a_moment_of_not_following_is_forgotten() -> None:
    sent, held = [3.0] * 60, [3.0] * 60
    held[20:28] = held[40:48] = [0.0] * 8
    assert [follows for follows, _ in judged(held, sent)].count(False) == 16
    assert not any(cause for _, cause in judged(held, sent))


@pytest.mark.parametrize(("held", "tolerance"), [(math.nan, 0.1), (0.0, None)])
def test_what_is_not_told_or_not_wanted_is_not_judged(held: float, tolerance: float | None) -> None:
    assert judged([held] * 60, [5.0] * 60, tolerance) == [(True, "")] * 60
