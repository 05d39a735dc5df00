"""The inverse followed along a horizon: compiled as sample by sample, within its limits, right where it can be."""

from __future__ import annotations

import numpy as np
import pytest

from hystmpc.models.inverse.inverses import (
    AccompaniedPredictor,
    Bounds,
    CompanionInverse,
    CompiledInverse,
    Follower,
    follower_for,
)
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.prediction.build import ControllerModel
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.prediction.exported import RoutedPredictor

from .lstm_examples import facts, make_route, random_weights
from .zoo import CHAINS, simulator

BOUNDS = Bounds(0.0, 6.0, 0.3)
CASES = [*CHAINS, "lstm, plain"]


def pair(name: str, lag_s: float) -> tuple[Predictor, Inverse]:
    if name in CHAINS:
        chain = CompiledPredictor.of_simulator(simulator(CHAINS[name]))
        predictor: Predictor = chain
        inverse: Inverse = CompiledInverse(chain, BOUNDS.low, 4.0)  # searches among less than may be sent
    else:
        weights = random_weights(7, 2)
        network = RoutedPredictor(facts(weights), "conditioned", make_route(weights, name.removeprefix("lstm, ")))
        chain = CompiledPredictor.of_simulator(simulator(CHAINS["backlash"]))
        predictor = both = AccompaniedPredictor(network, chain)
        inverse = CompanionInverse(both, CompiledInverse(chain, BOUNDS.low, BOUNDS.high))
    if not lag_s:
        return predictor, inverse
    whole, pair = simulator(CHAINS["backlash"]).metadata(), (predictor, inverse)
    return ControllerModel(whole, pair, pair).behind((Lag(lag_s),), whole).predictive


def step_by_step(predictor: Predictor, inverse: Inverse, given: tuple[np.ndarray, np.ndarray, float]) -> np.ndarray:
    """Commands (2, H) by one call of model and inverse for each sample."""
    plans = np.empty((2, given[1].size))
    for row, reach in enumerate((np.inf, BOUNDS.reach)):
        state, wanted, u = given
        for k, theta in enumerate(wanted):
            goal = min(max(inverse.command(state, theta, u), BOUNDS.low), BOUNDS.high)
            u = min(max(goal, u - reach), u + reach)
            _, state = predictor.advance(state, u)
            plans[row, k] = u
    return plans


def scenes(predictor: Predictor, follower: Follower, count: int = 12) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """States, wanted angles and last commands along a jagged motion."""
    rng, u, found = np.random.default_rng(4), 1.0, []
    state = predictor.initial(40.0, u)
    for k in range(count):
        wanted = 55.0 + 20.0 * np.sin(0.3 * (k + np.arange(9))) + rng.normal(0, 2.0 * (k % 3), 9)
        found.append((state, wanted, u))
        u = float(follower.follow(state, wanted, u, BOUNDS)[1, 0])
        _, state = predictor.advance(state, u)
    return found


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in ("backlash", "pi", "lstm, plain") else pytest.mark.slow) for n in CASES],
)
def test_a_preview_at_once_is_sample_by_sample(name: str) -> None:
    predictor, inverse = pair(name, 0.0)
    fast = follower_for(predictor, inverse)
    for state, wanted, u in scenes(predictor, fast):
        kept = state.copy(), wanted.copy()
        found = fast.follow(state, wanted, u, BOUNDS)
        np.testing.assert_allclose(found, step_by_step(predictor, inverse, (state, wanted, u)), rtol=0, atol=1e-8)
        np.testing.assert_array_equal(state, kept[0])
        np.testing.assert_array_equal(wanted, kept[1])
        np.testing.assert_array_equal(found, fast.follow(state, wanted, u, BOUNDS))


@pytest.mark.parametrize("lag_s", [0.0, 0.08])
@pytest.mark.parametrize("name", CASES)
def test_limits_hold_whatever_is_wanted(name: str, lag_s: float) -> None:
    predictor, inverse = pair(name, lag_s)
    follower, rng = follower_for(predictor, inverse), np.random.default_rng(0)
    for u in (0.0, 2.5, 6.0):
        free, limited = follower.follow(predictor.initial(40.0, u), rng.normal(50, 200, 15), u, BOUNDS)
        for plan in (free, limited):
            assert np.all((plan >= BOUNDS.low) & (plan <= BOUNDS.high))
        assert np.max(np.abs(np.diff(limited, prepend=u))) <= BOUNDS.reach * (1 + 1e-12)


def test_forward_after_the_free_plan_is_the_identity() -> None:
    predictor, inverse = pair("backlash", 0.0)
    state = predictor.initial(45.0, 1.5)
    wanted = np.array([46.0, 50.0, 58.0, 58.0, 57.0, 49.0])
    free, limited = follower_for(predictor, inverse).follow(state, wanted, 1.5, BOUNDS._replace(reach=6.0))
    np.testing.assert_allclose(predictor.rollout(state, free[None])[0], wanted, atol=1e-9)
    np.testing.assert_array_equal(free, limited)


@pytest.mark.parametrize("name", ["backlash", "pi"])
def test_behind_a_lag_an_angle_within_reach_is_followed(name: str) -> None:
    """The angles of admissible commands behind 80 ms of lag come out again, outside the dead band."""
    predictor, inverse = pair(name, 0.08)
    state, u = predictor.initial(25.0, 0.0), 1.0
    for before in np.linspace(0.0, u, 40):
        _, state = predictor.advance(state, before)
    commands = u + 1.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 20)))
    wanted = predictor.rollout(state, commands[None])[0]
    found = follower_for(predictor, inverse).follow(state, wanted, u, BOUNDS)[1]
    assert np.max(np.abs(predictor.rollout(state, found[None])[0] - wanted)) < 0.02


@pytest.mark.parametrize("name", ["backlash", "lstm, plain"])
def test_a_state_that_is_no_number_holds(name: str) -> None:
    predictor, inverse = pair(name, 0.0)
    state = predictor.initial(40.0, 1.0)
    state[0] = np.nan
    plans = follower_for(predictor, inverse).follow(state, np.full(5, 60.0), 1.25, BOUNDS)
    np.testing.assert_array_equal(plans, np.full((2, 5), 1.25))
