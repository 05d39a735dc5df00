"""Shares of causes, and the closed share with its bounds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.decide.gap_closed import ClosedShares, closed_interval, closed_share
from hystmpc.models.identify.runs import Blocks, blocks_of
from hystmpc.models.identify.uncertainty import Interval

from .engine_examples import device_runs

NAMES = ("creep", "lag", "slack", "drift")


def blocks(energy: Sequence[float]) -> Blocks:
    """Blocks of ten samples."""
    return Blocks(np.array(energy), np.full(len(energy), 10.0), np.zeros(len(energy), dtype=np.intp))


@st.composite
def corrections(draw: st.DrawFn) -> dict[frozenset[str], Blocks]:
    """Errors with every set of some causes; each cause lowers every block, whatever the others are."""
    names = NAMES[: draw(st.integers(1, len(NAMES)))]
    factors = {name: np.array(draw(st.lists(st.floats(0.05, 0.9), min_size=6, max_size=6))) for name in names}
    before = np.array(draw(st.lists(st.floats(1.0, 50.0), min_size=6, max_size=6)))
    sets = [frozenset(part) for k in range(len(names) + 1) for part in itertools.combinations(names, k)]
    return {part: blocks(before * np.prod([factors[name] for name in part], axis=0)) for part in sets}


def of_causes(errors: dict[frozenset[str], Blocks], spread: float = 0.0) -> dict[str, tuple[float, Interval]]:
    """Share and interval of every cause."""
    return ClosedShares(errors[frozenset()], 0.0, spread, 1).of_causes(max(errors, key=len), errors.__getitem__)


@given(corrections())
def test_shares_of_causes_add_up_to_what_all_do_together(errors: dict[frozenset[str], Blocks]) -> None:
    together = closed_share(errors[frozenset()].mse, errors[max(errors, key=len)].mse, 0.0)
    assert sum(share for share, _ in of_causes(errors).values()) == pytest.approx(together, abs=1e-9)


@given(corrections())
def test_a_cause_that_lowers_every_block_is_proven_however_small(errors: dict[frozenset[str], Blocks]) -> None:
    """Shares that average over all orders of adding are as uncertain as what the cause does to an error that a larger
    one has left unexplained."""
    for share, (low, high) in of_causes(errors).values():
        assert 0 < low <= share + 1e-12
        assert share <= high + 1e-12


@given(corrections())
def test_shares_rank_causes_by_the_error_without_them(errors: dict[frozenset[str], Blocks]) -> None:
    names = max(errors, key=len)
    shares = {name: share for name, (share, _) in of_causes(errors).items()}
    by_share = sorted(shares, key=lambda name: shares[name])
    left = [errors[names - {name}].mse for name in by_share]
    assert left == pytest.approx(sorted(left), rel=1e-9)


@given(corrections())
def test_of_two_causes_that_can_replace_each_other_none_closes_anything(errors: dict[frozenset[str], Blocks]) -> None:
    before, after = errors[frozenset()], errors[max(errors, key=len)]
    one, other = frozenset({"lag"}), frozenset({"delay"})
    twins = {frozenset[str](): before, one: after, other: after, one | other: after}
    for share, (low, high) in of_causes(twins).values():
        assert (share, low, high) == (0.0, 0.0, 0.0)


@given(corrections())
def test_a_cause_that_does_nothing_closes_nothing(errors: dict[frozenset[str], Blocks]) -> None:
    idle = {part | more: found for part, found in errors.items() for more in (frozenset(), frozenset({"idle"}))}
    share, interval = of_causes(idle)["idle"]
    assert share == 0.0
    assert interval == pytest.approx((0.0, 0.0), abs=1e-12)


def test_closed_share_is_the_formula() -> None:
    assert closed_share(4.0, 1.0, 0.0) == pytest.approx(0.75)
    assert closed_share(4.0, 2.0, 1.0) == pytest.approx(2 / 3)
    assert closed_share(4.0, 1.0, 1.0) == 1.0
    assert closed_share(4.0, 5.0, 0.0) == pytest.approx(-0.25)


@given(st.floats(0, 1e3), st.floats(0, 1e3), st.floats(0, 1e3))
def test_closed_share_stays_within_its_bounds(retuned: float, with_effects: float, floor: float) -> None:
    share = closed_share(retuned, with_effects, floor)
    assert -1.0 <= share <= 1.0
    if retuned <= floor:
        assert share == 0.0
    elif with_effects <= retuned:
        assert share >= 0.0


def test_an_interval_holds_its_share() -> None:
    random = np.random.default_rng(3)
    retuned = blocks((40 + 10 * random.standard_normal(60)).tolist())
    after = blocks((10 + 3 * random.standard_normal(60)).tolist())
    low, high = closed_interval(retuned, retuned, after, 0.5, 1)
    share = closed_share(retuned.mse, after.mse, 0.5)
    assert low < share < high
    assert high - low < 0.1
    assert (low, high) == closed_interval(retuned, retuned, after, 0.5, 1)


def test_an_error_that_falls_everywhere_surely_falls_beside_a_high_floor() -> None:
    retuned = blocks([5.0, 60.0] * 4)  # many resamples have no gap above the floor
    falls = blocks([4.0, 40.0] * 4)
    assert closed_interval(retuned, retuned, falls, 3.0, 1)[0] > 0
    assert closed_interval(retuned, falls, retuned, 3.0, 1)[1] < 0


def test_equal_stages_close_nothing() -> None:
    same = blocks([5.0, 7.0, 4.0, 6.0])
    assert closed_interval(same, same, same, 0.1, 0) == (0.0, 0.0)


def test_blocks_hold_all_of_the_error() -> None:
    runs = device_runs()
    errors = [np.random.default_rng(k).standard_normal(run.command.size) for k, run in enumerate(runs)]
    found = blocks_of(errors, runs)
    assert found.mse == pytest.approx(float(np.mean(np.concatenate(errors) ** 2)))
    assert found.samples.sum() == sum(run.command.size for run in runs)
