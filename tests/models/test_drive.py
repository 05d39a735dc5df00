"""Dynamics before or behind what is inverted: split from a chain, and led along a path within their limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hystmpc.core.library import engine
from hystmpc.models.chain import Chain, split
from hystmpc.models.inverse.drive import Drive, DrivenInverse
from hystmpc.models.inverse.inverses import Bounds, follower_for
from hystmpc.models.operators.dynamics import Delay, Lag, RateLimit, Servo
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.operators.static_curves import Slack
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel

from .zoo import BACKLASH, DT, RATE_PI, simulator

H, REACH = 20, 0.48
DRIVES: dict[str, tuple[Operator, ...]] = {
    "lag": (Lag(0.12),),
    "slow lag": (Lag(0.25),),
    "two ways": (Lag(0.08, (0.2,)),),
    "two lags": (Lag(0.08), Lag(0.06)),
    "servo": (Servo(0.1, 0.6),),
    "delay": (Delay(3 * DT, 3),),
    "delay and lag": (Delay(2 * DT, 2), Lag(0.12)),
    "rate limit": (RateLimit(9.0), Lag(0.08)),
}


def drive(name: str) -> tuple[Drive, np.ndarray]:
    """A drive and its state at rest at 2 mm."""
    found = Drive(DRIVES[name], simulator(Chain(BACKLASH)).metadata())
    state = found.predictor.initial(2.0, 2.0)
    for _ in range(200):
        _, state = found.predictor.advance(state, 2.0)
    return found, state


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in ("lag", "delay and lag") else pytest.mark.slow) for n in DRIVES]
)
def test_a_path_that_it_can_take_is_taken(name: str) -> None:
    found, state = drive(name)
    inputs = 2.0 + 1.2 * (1.0 - np.cos(np.linspace(0.0, np.pi, H)))
    wanted = found.predictor.rollout(state, inputs[None])[0]
    fit = found.fit(state, wanted, 2.0, REACH)
    np.testing.assert_allclose(fit.outputs, wanted, atol=0.02)
    np.testing.assert_allclose(found.predictor.rollout(state, fit.inputs[None])[0], fit.outputs, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_a_rest_is_kept_without_a_move(name: str) -> None:
    found, state = drive(name)
    np.testing.assert_allclose(found.fit(state, np.full(H, 2.0), 2.0, REACH).inputs, 2.0, atol=1e-9)


@pytest.mark.parametrize("name", DRIVES)
@given(seed=st.integers(0, 10_000), reach=st.floats(1e-3, 2.0))
@settings(max_examples=15, deadline=None)
def test_moves_stay_within_the_reach(name: str, seed: int, reach: float) -> None:
    found, state = drive(name)
    wanted = np.random.default_rng(seed).normal(2.0, 3.0, H)
    inputs = found.fit(state, wanted, 2.0, reach).inputs
    assert np.max(np.abs(np.diff(inputs, prepend=2.0))) <= reach * (1 + 1e-9)


@given(seed=st.integers(0, 10_000), reach=st.floats(0.02, 1.0), gain=st.floats(0.1, 1.0))
@settings(max_examples=40, deadline=None)
def test_the_program_is_solved_as_scipy_solves_it(seed: int, reach: float, gain: float) -> None:
    age = np.subtract.outer(np.arange(H), np.arange(H))
    by_move = np.where(age >= 0, 1.0 - (1.0 - gain) ** (np.maximum(age, 0) + 1.0), 0.0)
    off, weight = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.5, H)), 1e-3
    moves = np.zeros(H)
    engine().bounded_moves(by_move, off, H, reach, weight, moves, np.empty(2 * H * (H + 2)))
    rows, right = np.vstack([by_move, np.sqrt(weight) * np.eye(H)]), np.append(off, np.zeros(H))
    exact = lsq_linear(rows, right, (-reach, reach), tol=1e-12)
    assert np.max(np.abs(moves)) <= reach
    assert 0.5 * np.sum((rows @ moves - right) ** 2) <= exact.cost * (1 + 1e-6) + 1e-9


def test_a_delay_is_seen_in_the_response() -> None:
    found, state = drive("delay and lag")
    outputs, response = found.predictor.linearise(state, np.full(H, 2.0))
    assert engine().first_acting(response, H) == found.delay_samples == 2
    np.testing.assert_allclose(outputs, 2.0)
    assert engine().first_acting(np.zeros((H, H)), H) == H
    assert engine().first_acting(np.eye(H, k=-3), H) == 3


def test_a_chain_is_cut_at_its_dynamics() -> None:
    creep, slack, lag, late = Creep((0.15,), (8.0,)), Slack(0.3), Lag(0.1), Delay(0.08, 2)
    front, middle, back = split(Chain(BACKLASH, before=(creep, lag, slack), after=(creep, late)))
    assert (front, middle.before, middle.after, back) == ((creep, lag), (slack,), (creep,), (late,))
    assert split(Chain(BACKLASH, (creep,)))[0] == split(Chain(BACKLASH, (creep,)))[2] == ()


AFTER: dict[str, tuple[Operator, ...]] = {"none": (), "lag": (Lag(0.1),), "delay": (Delay(2 * DT, 2),)}
# Every drive, and behind the hysteresis what waits or lags behind one that does neither, one, or both of them.
AROUND = [(name, "none") for name in DRIVES]
QUICK = (("lag", "none"), ("delay and lag", "none"))
AROUND += [("lag", "lag"), ("delay and lag", "lag"), ("two ways", "delay"), ("delay", "delay")]


@pytest.mark.parametrize(
    ("name", "behind"),
    [pytest.param(*case, marks=() if case in QUICK else pytest.mark.slow) for case in AROUND],
)
def test_the_follower_keeps_limits_and_uses_the_preview(name: str, behind: str) -> None:
    """With dynamics on either side, angles of admissible commands come out again within a few hundredths."""
    predictor, inverse = controller_model(ChainModel(simulator(Chain(RATE_PI, DRIVES[name], AFTER[behind])))).predictive
    assert isinstance(inverse, DrivenInverse)
    bounds, state = Bounds(0.0, 6.0, REACH), predictor.initial(40.0, 0.0)
    for u in np.append(np.linspace(0.0, 2.0, 40), np.full(60, 2.0)):
        _, state = predictor.advance(state, float(u))
    commands = 2.0 + 1.2 * (1.0 - np.cos(np.linspace(0.0, np.pi, H)))
    wanted = predictor.rollout(state, commands[None])[0]
    for plan in follower_for(predictor, inverse).follow(state, wanted, 2.0, bounds):
        assert np.all((plan >= bounds.low) & (plan <= bounds.high))
        assert np.max(np.abs(np.diff(plan, prepend=2.0))) <= bounds.reach * (1 + 1e-9)
        assert np.max(np.abs(predictor.rollout(state, plan[None])[0] - wanted)) < 0.6
    nowhere = np.full_like(state, np.nan)
    np.testing.assert_array_equal(follower_for(predictor, inverse).follow(nowhere, wanted, 2.0, bounds), 2.0)
