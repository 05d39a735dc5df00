"""Shapley's axioms, and the closed share with its bounds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.decide.closed_share import closed_interval, closed_share, shapley
from hystmpc.models.identify.runs import Blocks, blocks_of

from .engine_examples import device_runs

NAMES = ("creep", "lag", "slack", "drift")
SIZES = st.floats(-100, 100)
Game = dict[frozenset[str], float]


@st.composite
def games(draw: st.DrawFn) -> tuple[tuple[str, ...], Game]:
    """Some names and a value for each of their sets."""
    names = NAMES[: draw(st.integers(1, len(NAMES)))]
    sets = [frozenset(part) for k in range(len(names) + 1) for part in itertools.combinations(names, k)]
    return names, {part: draw(SIZES) for part in sets}


@given(games())
def test_shares_add_up_to_what_all_do_together(game: tuple[tuple[str, ...], Game]) -> None:
    names, values = game
    shares = shapley(names, values.__getitem__)
    assert sum(shares.values()) == pytest.approx(values[frozenset(names)] - values[frozenset()], abs=1e-9)


@given(games())
def test_names_that_do_the_same_get_the_same(game: tuple[tuple[str, ...], Game]) -> None:
    names, values = game
    if len(names) < 2:
        return
    a, b = names[:2]
    swapped = {a: b, b: a}

    def value(kept: frozenset[str]) -> float:
        mirrored = frozenset(swapped.get(name, name) for name in kept)
        return values[kept] + values[mirrored]

    shares = shapley(names, value)
    assert shares[a] == pytest.approx(shares[b], abs=1e-9)


@given(games(), SIZES)
def test_who_adds_the_same_to_every_set_gets_that(game: tuple[tuple[str, ...], Game], own: float) -> None:
    """A dummy, whose own worth is zero, gets nothing."""
    names, values = game
    dummy = names[0]
    shares = shapley(names, lambda kept: values[kept - {dummy}] + (own if dummy in kept else 0.0))
    assert shares[dummy] == pytest.approx(own, abs=1e-9)


@given(games(), st.floats(-3, 3))
def test_shares_are_linear_in_the_value(game: tuple[tuple[str, ...], Game], factor: float) -> None:
    names, values = game
    plain = shapley(names, values.__getitem__)
    scaled = shapley(names, lambda kept: factor * values[kept] + 7.0)
    for name in names:
        assert scaled[name] == pytest.approx(factor * plain[name], abs=1e-8)


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


def blocks(energy: list[float]) -> Blocks:
    """Blocks of ten samples."""
    return Blocks(np.array(energy), np.full(len(energy), 10.0), np.zeros(len(energy), dtype=np.intp))


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
