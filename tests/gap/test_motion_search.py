"""The family of motions keeps every limit; the search finds a motion worth more than the menu's, the same each time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.next.motion_design import Noise, OpenHypothesis, SearchSettings, information_bits, search_motion
from hystmpc.gap.next.motions import SIZE, TEMPLATES, MotionFamily, menu
from hystmpc.trials.errors import TrajectoryError

from .contenders import DELAY, LAG, baseline

LIMITS = CommandLimits(0.0, 6.0, 12.0)
FAMILY = MotionFamily(LIMITS, 0.04, 0.0, 20.0)
NOISE = Noise(0.1, form_deg=1.0)
QUICK = SearchSettings(seed=3, overhead_s=2.0, generations=2)

numbers = arrays(np.float64, SIZE, elements=st.floats(-0.5, 1.5))


@given(
    x=numbers,
    lower=st.floats(-100, 100),
    span=st.floats(1e-3, 1e3),
    speed=st.floats(0.01, 100),
    safe=st.floats(0, 1),
    dt=st.floats(0.005, 0.1),
    longest=st.floats(5, 60),
)
@settings(max_examples=100)
def test_every_motion_keeps_the_limits_the_duration_and_the_safe_command(
    x: np.ndarray, lower: float, span: float, speed: float, safe: float, dt: float, longest: float
) -> None:
    limits = CommandLimits(lower, lower + span, speed * span)
    rest = min(max(lower + safe * span, limits.lower), limits.upper)
    u = MotionFamily(limits, dt, rest, longest).motion(x, "any").command
    slack = 1e-9 * max(1.0, abs(lower), span)
    assert u.min() >= limits.lower
    assert u.max() <= limits.upper
    assert np.abs(np.diff(u)).max() <= limits.rate * dt + slack
    assert (u.size - 1) * dt <= longest + 1e-6
    resting = int(0.5 / dt)
    assert np.abs(u[: resting + 1] - rest).max() <= slack
    assert np.abs(u[-resting - 1 :] - rest).max() <= slack


def test_the_motions_of_the_menu_are_members() -> None:
    assert set(FAMILY.starts) == {template.name for template in TEMPLATES}
    strokes = FAMILY.motion(FAMILY.starts["opening_repeat"], "opening_repeat").command
    tops = np.flatnonzero((strokes[1:-1] > strokes[:-2]) & (strokes[1:-1] >= 0.99 * LIMITS.upper))
    assert tops.size == 3  # three strokes over the whole range
    waves = FAMILY.motion(FAMILY.starts["small_multi_sine"], "small_multi_sine").command
    turns = np.count_nonzero(np.diff(np.sign(np.diff(waves[np.abs(waves - 3.0) < 1.0]))))
    assert turns > 10


def test_a_slower_motion_is_slower_and_goes_as_far() -> None:
    family = MotionFamily(LIMITS, 0.04, 0.0, 120.0)
    x = family.starts["fast_strokes"]
    fast, slow = family.motion(x, "fast").command, family.motion(family.slower(x, 0.25), "slow").command
    assert np.abs(np.diff(slow))[:-60].max() < 0.3 * np.abs(np.diff(fast)).max()
    assert slow.max() == pytest.approx(fast.max())


@pytest.mark.parametrize("wrong", [(0.0, 0.0, 20.0), (0.04, 7.0, 20.0), (0.04, 0.0, 1.0)])
def test_a_family_of_no_motions_is_refused(wrong: tuple[float, float, float]) -> None:
    with pytest.raises(TrajectoryError, match="expected dt > 0"):
        MotionFamily(LIMITS, *wrong)


@given(p=st.floats(0, 1), more=st.floats(0, 1), count=st.integers(2, 9))
def test_information_is_none_by_chance_all_by_certainty_and_grows(p: float, more: float, count: int) -> None:
    assert information_bits(1 / count, count) == pytest.approx(0.0, abs=1e-9)
    assert information_bits(1.0, count) == pytest.approx(np.log2(count))
    assert information_bits(p, count) <= information_bits(min(p + more, 1.0), count)


def test_the_search_beats_the_menu_keeps_the_time_and_finds_the_same_again() -> None:
    found = search_motion((LAG, DELAY), FAMILY, NOISE, QUICK, menu(LIMITS, 0.04))
    again = search_motion((LAG, DELAY), FAMILY, NOISE, QUICK, menu(LIMITS, 0.04))
    assert found is not None
    assert again is not None
    assert found.gain >= 1.0
    assert found.menu is not None
    assert 6.0 <= found.chosen.motion.duration_s <= FAMILY.longest_s
    assert found.seconds == pytest.approx(found.chosen.motion.duration_s + QUICK.overhead_s)
    assert np.array_equal(found.chosen.motion.command, again.chosen.motion.command)
    assert np.array_equal(FAMILY.motion(found.numbers, "same").command, found.chosen.motion.command)


def test_what_is_not_allowed_is_not_chosen() -> None:
    def low(option: object) -> bool:
        return bool(option.motion.command.max() < 3.0)  # type: ignore[attr-defined]

    careful = SearchSettings(seed=3, generations=1, allowed=low)
    found = search_motion((LAG, DELAY), FAMILY, NOISE, careful)
    assert found is not None
    assert found.chosen.motion.command.max() < 3.0
    nothing = SearchSettings(seed=3, generations=1, allowed=lambda option: False)
    assert search_motion((LAG, DELAY), FAMILY, NOISE, nothing) is None


def test_equal_explanations_give_no_information() -> None:
    same = [OpenHypothesis(name, baseline, (baseline,)) for name in ("one", "other")]
    found = search_motion(same, FAMILY, NOISE, SearchSettings(generations=1))
    assert found is not None
    assert found.bits == pytest.approx(0.0, abs=1e-6)
