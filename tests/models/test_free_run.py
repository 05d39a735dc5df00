"""The free-run engine: every operator alone and in chains equals its own equation, with exact sensitivities."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.hysteresis import CurvedPlays
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep, FirstFlexure, TrialShift
from hystmpc.models.operators.static_curves import Contact, NonlinearGain
from hystmpc.models.program import dense
from hystmpc.trials.errors import ModelError

from .zoo import BACKLASH, CHAINS, DT, EXAMPLES, RATE_PI

pytestmark = pytest.mark.slow

CASES = [*(Chain(example) for example in EXAMPLES), *CHAINS.values()]
IDS = [*(f"{example.name}-{k}" for k, example in enumerate(EXAMPLES)), *CHAINS]
ANGLE = 41.0
HELD = 2.7  # no example has a kink there


def wandering(samples: int = 240, seed: int = 3) -> np.ndarray:
    """A command over the whole range with reversals of all sizes, holds included (T,) [mm]."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * DT
    u = 3 + 2.5 * np.sin(2 * np.pi * 0.4 * t) + 0.4 * np.sin(2 * np.pi * 2.3 * t + rng.uniform(0, 6))
    u[samples // 2 : samples // 2 + 30] = u[samples // 2]
    return u


@pytest.mark.parametrize("chain", CASES, ids=IDS)
def test_a_run_equals_the_equation_sample_by_sample(chain: Chain) -> None:
    staged, u = StagedChain(chain), wandering()
    x = staged.rest(u[:1], np.array([ANGLE]))
    np.testing.assert_allclose(
        x[:, 0], np.asarray(chain.rest(ANGLE, u[0], chain.values)).ravel(), rtol=1e-12, atol=1e-12
    )
    theta, last = staged.simulate(u[:, None], DT, x)
    state, expected = x[:, 0], np.empty(u.size)
    for k, command in enumerate(u):
        y, state = (np.asarray(part).ravel() for part in chain.transition(state, command, chain.values, DT))
        expected[k] = y[0]
    np.testing.assert_allclose(theta[:, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(last[:, 0], state, rtol=0, atol=1e-9)


def forward_sensitivity(chain: Chain, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (T,) and their derivative (T, P) from rest, by the chain rule over the whole chain's own equation."""
    x, command, values = ca.SX.sym("x", chain.state_size), ca.SX.sym("u"), ca.SX.sym("p", p.size)
    y, following = chain.transition(x, command, values, DT)
    by = [ca.jacobian(part, variable) for part in (y, following) for variable in (x, values)]
    step = dense("step", [x, command, values], [y, following, *by])
    rest = chain.rest(ANGLE, command, values)
    state, slope = dense("rest", [command, values], [rest, ca.jacobian(rest, values)])(u[0], p)
    slope = np.asarray(slope)
    theta, gradient = np.empty(u.size), np.empty((u.size, p.size))
    for k, sent in enumerate(u):
        angle, state, y_x, y_p, x_x, x_p = (np.asarray(part) for part in step(state, sent, p))
        theta[k], gradient[k], slope = angle.item(), (y_x @ slope + y_p).ravel(), x_x @ slope + x_p
    return theta, gradient


@pytest.mark.parametrize("chain", CASES, ids=IDS)
def test_sensitivities_equal_those_of_the_whole_chain(chain: Chain) -> None:
    u, p = wandering(), chain.values
    staged = StagedChain(chain)
    theta, gradient = staged.differentiate(u, DT, *staged.rest_with_slope(u[:1], np.array([ANGLE])))
    reference, by_p = forward_sensitivity(chain, u, p)
    np.testing.assert_allclose(theta, reference, rtol=0, atol=1e-9)
    np.testing.assert_allclose(gradient, by_p, rtol=1e-8, atol=1e-8)


def settled(staged: StagedChain, angle: float, values: np.ndarray | None = None) -> np.ndarray:
    """State (S,) of one row."""
    return staged.settled(np.array([HELD]), np.array([angle]), DT, values)[0][:, 0]


@pytest.mark.parametrize("chain", CASES, ids=IDS)
def test_a_settled_chain_shows_what_was_seen_and_knows_its_derivative(chain: Chain) -> None:
    staged, held = StagedChain(chain), np.full((3, 1), HELD)
    p = chain.values
    x, slope = (found[:, 0] for found in staged.settled(np.array([HELD]), np.array([ANGLE]), DT, p))
    shown = staged.simulate(held, DT, x[:, None], p)[0]
    reachable = staged.simulate(held[:1], DT, staged.settled(np.array([HELD]), shown[0], DT, p)[0], p)[0]
    np.testing.assert_allclose(reachable, shown[:1], atol=1e-6)  # what it shows once, it can show again
    for k, value in enumerate(p):
        step = 1e-6 * max(abs(value), 1.0)
        ends = [settled(staged, ANGLE, p + s * step * np.eye(p.size)[k]) for s in (1, -1)]
        sides = [(ends[0] - x) / step, (x - ends[1]) / step]
        near = np.minimum(np.abs(slope[:, k] - sides[0]), np.abs(slope[:, k] - sides[1]))  # one side of a kink
        assert np.all(near < 1e-3 * (1 + np.abs(slope[:, k]))), chain.labels[k]


BENT = (19.96, 6.70, 0.002, 1.65, 4.16, 1.05, 2.53, 0.011, 0.03, 1.59, 5.23, 5.93)
BEHIND = {
    "bent plays": Chain(CurvedPlays(BENT, 12.9, (0.026, 0.147, 0.089, 0.529, 3.87), HELD + 1.2, HELD + 2.0, 1)),
    "curved": Chain(BACKLASH, after=(NonlinearGain(0.004, 0.0, 59.5),)),
    "stopped": Chain(BACKLASH, after=(Contact(30.0, 0.4),)),
    "shifted": Chain(RATE_PI, after=(TrialShift(-6.0, 1.1, 0.5),)),
    "creeping": Chain(BACKLASH, after=(Creep((0.3,), (2.0,)),)),
}


def shown_at_rest(chain: Chain, angle: float) -> float:
    """Angle that a chain shows which has settled at an angle, or nearest to it [deg]."""
    staged = StagedChain(chain)
    state = settled(staged, angle)[:, None]
    return float(staged.simulate(np.full((1, 1), HELD), DT, state)[0][0, 0])


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.001, 0.999), st.sampled_from([(), (FirstFlexure(0.3, 20.0, 0.4),)]))
def test_curves_of_any_bend_are_settled_at_any_angle_that_they_can_hold(
    seed: int, share: float, after: tuple[Operator, ...]
) -> None:
    """Slopes of neighbouring knots may differ a hundredfold, so that a step along the tangent leaves the range."""
    rng = np.random.default_rng(seed)
    plays, pieces = int(rng.integers(1, 5)), int(rng.integers(1, 9))
    slopes = tuple(10.0 ** rng.uniform(-1.0, 1.0, (plays + 1) * (pieces + 1)))
    core = CurvedPlays(slopes, 0.0, tuple(10.0 ** rng.uniform(-1.5, 0.7, plays)), 0.0, 6.0, pieces)
    chain = Chain(core, after=after)
    low, high = (shown_at_rest(chain, angle) for angle in (-1e4, 1e4))
    angle = low + share * (high - low)
    assert shown_at_rest(chain, angle) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("chain", BEHIND.values(), ids=list(BEHIND))
@pytest.mark.parametrize("share", [0.0005, 0.02, 0.5, 0.98, 0.9995])
def test_any_angle_that_the_chain_can_hold_is_shown_wherever_the_core_stands(chain: Chain, share: float) -> None:
    """The angle seen, taken for the core's own, may lie beyond what the core can hold at that command."""
    low, high = (shown_at_rest(chain, angle) for angle in (-400.0, 400.0))
    assert low < high
    angle = low + share * (high - low)
    assert shown_at_rest(chain, angle) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("chain", BEHIND.values(), ids=list(BEHIND))
def test_a_run_from_a_settled_start_has_exact_derivatives(chain: Chain) -> None:
    """The core's start depends on what stands behind it, and so does everything after it."""
    staged, p = StagedChain(chain), chain.values
    u = np.concatenate([np.full(5, HELD), wandering()[:80]])
    ends = [settled(staged, angle) for angle in (-400.0, 400.0)]
    low, high = (float(staged.simulate(u[:1, None], DT, x[:, None])[0][0, 0]) for x in ends)
    angle = 0.5 * (low + high)

    def run(values: np.ndarray) -> np.ndarray:
        x = settled(staged, angle, values)
        return staged.simulate(u[:, None], DT, x[:, None], values)[0][:, 0]

    theta, by = staged.differentiate(u, DT, *staged.settled(np.array([HELD]), np.array([angle]), DT, p), p)
    np.testing.assert_allclose(theta, run(p), atol=1e-9)
    for k, value in enumerate(p):
        step = 1e-6 * max(abs(value), 1.0) * np.eye(p.size)[k]
        found = (run(p + step) - run(p - step)) / (2 * step[k])
        off = np.abs(by[:, k] - found) > 1e-4 * (1.0 + np.abs(found).max())
        assert np.mean(off) <= 0.05, chain.labels[k]


def test_rows_are_independent_and_have_their_own_parameters() -> None:
    chain = CHAINS["delayed pi with lag"]
    staged = StagedChain(chain)
    u = np.stack([wandering(seed=k) for k in range(5)], axis=1)
    values = chain.values[:, None] * np.linspace(0.9, 1.1, 5)
    angles = np.linspace(30.0, 60.0, 5)
    together, _ = staged.simulate(u, DT, staged.rest(u[0], angles, values), values)
    for n in range(5):
        own = values[:, n]
        alone, _ = staged.simulate(u[:, n : n + 1], DT, staged.rest(u[0, n : n + 1], angles[n : n + 1], own), own)
        np.testing.assert_array_equal(together[:, n], alone[:, 0])


def test_a_run_cut_in_two_is_the_run() -> None:
    staged, u = StagedChain(CHAINS["delayed pi with lag"]), wandering()[:, None]
    start = staged.rest(u[0], np.array([ANGLE]))
    whole, end = staged.simulate(u, DT, start)
    first, middle = staged.simulate(u[:100], DT, start)
    second, last = staged.simulate(u[100:], DT, middle)
    np.testing.assert_array_equal(whole, np.concatenate([first, second]))
    np.testing.assert_array_equal(end, last)


@pytest.mark.parametrize("name", ["shifted", "stopped"])
def test_runs_laid_end_to_end_are_the_runs_alone(name: str) -> None:
    """Rows that can show their angle and rows that cannot, of several lengths, in directions that mix parameters."""
    chain = BEHIND[name]
    staged, p = StagedChain(chain), chain.values
    signals = [wandering(count, seed) for seed, count in enumerate((90, 40, 1, 130))]
    signals[2] = signals[0][:1].copy()
    angles = np.array([-400.0, 20.0, 41.0, 400.0])
    seeds = np.random.default_rng(1).standard_normal((p.size, 3))
    first = np.cumsum([0, *(u.size for u in signals)])
    commands = np.concatenate(signals)
    start = staged.settled(commands[first[:-1]], angles, DT, p, seeds)
    theta, by = staged.differentiate(commands, DT, *start, p, seeds, first)
    for k, u in enumerate(signals):
        alone = staged.settled(u[:1], angles[k : k + 1], DT, p)
        np.testing.assert_array_equal(start[0][:, k], alone[0][:, 0])
        own, by_p = staged.differentiate(u, DT, *alone, p)
        np.testing.assert_array_equal(theta[first[k] : first[k + 1]], own)
        np.testing.assert_allclose(by[first[k] : first[k + 1]], by_p @ seeds, rtol=1e-9, atol=1e-9)


def test_any_number_of_directions_is_taken() -> None:
    staged, u = StagedChain(Chain(BACKLASH)), wandering(60)
    start = staged.rest_with_slope(u[:1], np.array([ANGLE]))
    by = staged.differentiate(u, DT, *start)[1]
    seeds = np.tile(np.eye(4), 70)
    many = staged.differentiate(u, DT, *staged.rest_with_slope(u[:1], np.array([ANGLE]), seeds=seeds), seeds=seeds)[1]
    np.testing.assert_array_equal(many, np.tile(by, 70))


@pytest.mark.parametrize("count", range(1, 18))
def test_a_direction_does_not_depend_on_how_many_there_are(count: int) -> None:
    staged, u = StagedChain(Chain(BACKLASH)), wandering(60)
    by = staged.differentiate(u, DT, *staged.rest_with_slope(u[:1], np.array([ANGLE])))[1]
    seeds = np.tile(np.eye(4), 5)[:, :count]
    start = staged.rest_with_slope(u[:1], np.array([ANGLE]), seeds=seeds)
    np.testing.assert_array_equal(staged.differentiate(u, DT, *start, seeds=seeds)[1], np.tile(by, 5)[:, :count])


def test_order_matters_and_needs_no_new_kernel() -> None:
    """A static curve and a play do not commute: the engine keeps the order of the signal."""
    u = wandering()[:, None]
    one, other = Chain(BACKLASH, before=(RATE_PI,)), Chain(RATE_PI, before=(BACKLASH,))
    runs = [
        staged.simulate(u, DT, staged.rest(u[0], np.array([ANGLE])))[0]
        for staged in (StagedChain(one), StagedChain(other))
    ]
    assert np.abs(runs[0] - runs[1]).max() > 1.0


def test_wrong_shapes_are_refused() -> None:
    staged = StagedChain(Chain(BACKLASH))
    with pytest.raises(ModelError, match=r"got parameters of shape \(3,\), expected \(4,\) or \(4, 1\)"):
        staged.rest_with_slope(np.zeros(1), np.array([ANGLE]), np.zeros(3))
    with pytest.raises(ModelError, match=r"states of shape \(2, 1\), expected \(T, N\) and \(1, N\)"):
        staged.simulate(wandering()[:, None], DT, np.zeros((2, 1)))
