"""Commands to identify from and references to verify with: within limits, from rest to rest, within the minutes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hystmpc.bench.config import CommissionSettings, narrowed
from hystmpc.bench.motions import ReachedAngles, budget, prepare_seconds, recordings, references
from hystmpc.rig.safety.plausibility import PlausibilitySettings
from hystmpc.trials.errors import ConfigError

from .small_commission import BENCH

WHOLE = BENCH | {"commission": {"diagnose": False}}


def bench(lower: float, upper: float, rate: float, safe: float, **more: object) -> CommissionSettings:
    limits = {"lower": lower, "upper": upper, "rate_per_s": rate}
    ramps = {"velocity_per_s": min(3.0, rate), "acceleration_per_s2": 30.0, "jerk_per_s3": 300.0}
    return CommissionSettings.parse(WHOLE | {"limits": limits, "safe_command": safe, "ramps": ramps} | more)


@given(
    lower=st.floats(-3.0, 3.0),
    stroke=st.floats(0.5, 10.0),
    rate=st.floats(0.5, 30.0),
    safe=st.sampled_from([0.0, 1.0, 0.3, 0.9]),
    share=st.floats(0.2, 1.0),
    seed=st.integers(0, 100),
)
def test_recordings_keep_to_the_limits_and_go_from_rest_to_rest(
    lower: float, stroke: float, rate: float, safe: float, share: float, seed: int
) -> None:
    given_ = bench(lower, lower + stroke, rate, lower + safe * stroke)
    for commands in recordings(given_, share, seed).values():
        assert commands.min() >= given_.limits.lower - 1e-9
        assert commands.max() <= given_.limits.upper + 1e-9
        assert np.abs(np.diff(commands)).max() <= rate * given_.dt_s * (1 + 1e-9)
        assert commands[0] == pytest.approx(given_.safe_command, abs=1e-9)
        assert commands[-1] == pytest.approx(given_.safe_command, abs=1e-9)


@given(
    minutes=st.floats(1.0, 5.0),
    rate=st.floats(2.0, 20.0),
    safe=st.sampled_from([0.0, 3.0, 6.0]),
    steps=st.integers(4, 20),
    prepared=st.booleans(),
)
def test_the_minutes_are_kept(minutes: float, rate: float, safe: float, steps: int, prepared: bool) -> None:
    """What is said beforehand is no more than what is allowed, and recordings take no longer than was said."""
    prepare = [{"step": "flexure", "lower": 0, "upper": 6}, {"step": "relaxation", "duration_s": 2}]
    block = {"minutes": minutes, "range_steps": steps, "diagnose": False}
    given_ = bench(0.0, 6.0, rate, safe, commission=block, prepare=prepare if prepared else [])
    try:
        found = budget(given_)
    except ConfigError:
        assume(False)
        return
    assert found.total_s <= 60 * minutes + 1e-6
    played = sum(commands.size for commands in recordings(given_, found.share, 1).values()) * given_.dt_s
    assert played <= found.record_s + 1e-6


def test_too_few_minutes_are_refused() -> None:
    for minutes, expected in ((0.4, "for recordings after"), (2.2, "for each motion of the verification")):
        with pytest.raises(ConfigError, match=f"{expected}.*expected more minutes"):
            budget(bench(0.0, 6.0, 10.0, 0.0, commission={"minutes": minutes}))


def test_preparation_counts_as_long_as_it_lasts() -> None:
    prepare = [
        {"step": "relaxation", "duration_s": 2},
        {"step": "move", "to": 3},
        {"step": "relaxation", "duration_s": 1},
    ]
    check = {"step": "pretension_check", "by": 1, "least_move_deg": 3, "most_move_deg": 20}
    alone = prepare_seconds(bench(0.0, 6.0, 10.0, 0.0, prepare=prepare))
    assert 4.0 <= alone <= 5.0
    assert prepare_seconds(bench(0.0, 6.0, 10.0, 0.0, prepare=[*prepare, check])) > alone + 1.0


@given(
    low=st.floats(-20.0, 60.0),
    width=st.floats(5.0, 120.0),
    speed=st.floats(5.0, 500.0),
    seconds=st.floats(4.0, 15.0),
    seed=st.integers(0, 1000),
)
def test_references_stay_within_the_reached_angles_and_speed(
    low: float, width: float, speed: float, seconds: float, seed: int
) -> None:
    reached = ReachedAngles(low, low + width, speed)
    for motion in references(reached, seconds, (seed, 4)).values():
        trajectory = motion.build()
        t = np.arange(0.0, trajectory.duration_s, 0.01)
        angles = trajectory(t)
        assert angles.min() >= low - 1e-9
        assert angles.max() <= low + width + 1e-9
        assert np.abs(np.diff(angles)).max() / 0.01 <= 0.36 * speed + 1e-6


@given(
    span=st.floats(1.0, 6.0),
    still=st.floats(0.0, 6.0),
    travel=st.one_of(st.none(), st.floats(0.1, 6.0)),
)
def test_a_tip_that_stays_over_all_of_a_narrower_range_is_found(
    span: float, still: float, travel: float | None
) -> None:
    """Whatever was set for the whole range; and the longest travel that was seen without motion is no fault."""
    whole = bench(0.0, 6.0, 10.0, 0.0)
    whole = whole.model_copy(update={"plausibility": PlausibilitySettings(travel=travel)})
    found = narrowed(whole, 0.0, span, 1.5, min(still, span)).plausibility.travel
    assert found is not None
    assert found <= 0.9 * span + 1e-9
    if travel is None:
        assert found >= min(still, 0.9 * span) - 1e-9
    else:
        assert found == pytest.approx(min(travel, 0.9 * span))


def test_narrower_limits_leave_what_the_device_is_as_it_was() -> None:
    whole = bench(0.0, 6.0, 10.0, 0.0)
    narrow = narrowed(whole, 0.0, 2.0, 1.5)
    assert narrow.limits.build() == type(narrow.limits)(lower=0, upper=2, rate_per_s=1.5).build()
    assert narrow.overshoot == whole.overshoot
    assert narrow.ramps.velocity_per_s == 1.5
    with pytest.raises(ConfigError, match="safe_command"):
        narrowed(whole, 1.0, 2.0, 1.5)
