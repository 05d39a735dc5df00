"""A device that does not hold what it was sent is found; one that is slow is left alone."""

from __future__ import annotations

import math

import numpy as np
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


@given(lag_s=st.floats(0.01, 0.5), rate=st.floats(0.5, 12.0), seed=st.integers(0, 1000))
def test_a_drive_that_lags_by_less_than_the_window_follows(lag_s: float, rate: float, seed: int) -> None:
    """It says where it is: behind every ramp, and for a while after its end."""
    random, sent = np.random.default_rng(seed), [0.0]
    while len(sent) < 400:
        target = random.uniform(0.0, 6.0)
        steps = max(math.ceil(abs(target - sent[-1]) / (0.04 * rate)), 1)
        sent += np.linspace(sent[-1], target, steps + 1)[1:].tolist() + [target] * int(random.integers(0, 40))
    held = [0.0]
    for u in sent[1:]:
        held.append(held[-1] + (1.0 - math.exp(-0.04 / lag_s)) * (u - held[-1]))
    assert all(follows and not dead for follows, dead in judged(held, sent))


@pytest.mark.parametrize("told", [1, 2, 5])
def test_samples_in_which_nothing_is_told_forgive_nothing(told: int) -> None:
    """A device off what it was sent that tells in every fifth sample alone is found as soon as any."""
    sent = [min(0.2 * k, 6.0) for k in range(80)]
    held = [0.0 if k % told == 0 else math.nan for k in range(80)]
    dead = next(k for k, (_, cause) in enumerate(judged(held, sent)) if cause)
    assert dead <= 2 * WINDOW + 3 + told


@pytest.mark.parametrize(("held", "tolerance"), [(math.nan, 0.1), (0.0, None)])
def test_what_is_not_told_or_not_wanted_is_not_judged(held: float, tolerance: float | None) -> None:
    assert judged([held] * 60, [5.0] * 60, tolerance) == [(True, "")] * 60
