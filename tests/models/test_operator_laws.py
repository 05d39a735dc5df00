"""Laws of hysteresis, over every operator that obeys them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain, operator_from, operator_spec, operators
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.friction import Asymmetry
from hystmpc.models.operators.hysteresis import Play, Stop
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import FirstFlexure, TrialShift
from hystmpc.models.operators.static_curves import Contact, NonlinearGain, Slack
from hystmpc.trials.errors import ModelError

from .running import run_operator
from .zoo import BACKLASH, CURVED, DT, EXAMPLES, RATE_PI, SLIDERS, STATIC_PI

EFFECTS = (
    FirstFlexure(0.2, 1.5),
    Slack(0.6),
    Contact(4.0, 0.3),
    NonlinearGain(0.03, -0.002, 2.0),
    Asymmetry(1.2, 0.85, 3.0),
    TrialShift(0.4, 1.1, 0.2),
)
RISING = (Play(0.4), BACKLASH, STATIC_PI, CURVED, *EFFECTS)
RATE_INDEPENDENT = (*RISING, Stop(0.4), SLIDERS)
FORWARD = (*RISING, RATE_PI)
corners = st.lists(st.floats(0.0, 6.0), min_size=3, max_size=8)


def label(operator: Operator) -> str:
    """Name and rate dependence."""
    return f"{operator.name} beta={getattr(operator, 'beta', 0.0)}"


def polyline(points: list[float], samples: int) -> np.ndarray:
    """Straight moves between points, each of `samples` samples, monotone to the last bit."""
    moves = [np.linspace(a, b, samples + 1)[1:] for a, b in itertools.pairwise(points)]
    return np.concatenate([[points[0]], *moves])


def test_every_operator_has_an_example() -> None:
    assert {type(example) for example in EXAMPLES} == set(operators().values())


@pytest.mark.parametrize("operator", RATE_INDEPENDENT, ids=lambda o: o.name)
@given(points=corners)
def test_rate_independence(operator: Operator, points: list[float]) -> None:
    """Where a path is traversed at another speed, the output at its corners is the same."""
    slow = run_operator(operator, polyline(points, 17))[::17]
    fast = run_operator(operator, polyline(points, 3))[::3]
    np.testing.assert_allclose(slow, fast, atol=1e-9)


@pytest.mark.parametrize("operator", FORWARD, ids=label)
@given(points=corners)
def test_a_hold_gives_a_constant_output(operator: Operator, points: list[float]) -> None:
    held = np.concatenate([polyline(points, 5), np.full(20, points[-1])])
    settling = operator.settling_samples
    assert np.ptp(run_operator(operator, held)[-20 + settling :]) <= 1e-12


@pytest.mark.parametrize("operator", RATE_INDEPENDENT, ids=lambda o: o.name)
@given(low=st.floats(1.0, 2.0), high=st.floats(4.0, 5.0), inner=st.floats(2.2, 3.8))
def test_return_point_memory(operator: Operator, low: float, high: float, inner: float) -> None:
    """After an inner loop the path goes on as if the inner loop had not been."""
    with_loop = run_operator(operator, polyline([0.0, high, low, inner, low, low - 0.5], 11))
    without = run_operator(operator, polyline([0.0, high, low, low - 0.5], 11))
    np.testing.assert_allclose(with_loop[-11:], without[-11:], atol=1e-9)


# A minimum erases nothing of a set; that a larger maximum does stands in test_effects.py.
@pytest.mark.parametrize("operator", [o for o in RATE_INDEPENDENT if o.name != "first_flexure"], ids=lambda o: o.name)
@given(history=corners)
def test_wiping_out(operator: Operator, history: list[float]) -> None:
    """A larger extremum erases all smaller ones before it."""
    tail = [-3.0, 9.0, 1.0]
    long = run_operator(operator, polyline([*history, *tail], 9))
    short = run_operator(operator, polyline([history[0], *tail], 9))
    np.testing.assert_allclose(long[-19:], short[-19:], atol=1e-9)


@given(low=st.floats(0.5, 2.0), high=st.floats(3.0, 5.0), first=st.floats(-2.0, -1.0), second=st.floats(7.0, 9.0))
def test_congruency_of_prandtl_ishlinskii(low: float, high: float, first: float, second: float) -> None:
    """Minor loops between the same two commands have the same shape, whatever came before."""
    loops = []
    for history in (first, second):
        # Once around closes the loop; how its first branch is entered still depends on the history.
        theta = run_operator(STATIC_PI, polyline([0.0, history, low, high, low, high, low], 13))[-27:]
        loops.append(theta - theta[0])
    np.testing.assert_allclose(loops[0], loops[1], atol=1e-9)


@pytest.mark.parametrize("operator", FORWARD, ids=label)
@given(points=corners)
def test_the_angle_never_falls_while_the_command_rises(operator: Operator, points: list[float]) -> None:
    u = polyline(points, 7)
    theta = run_operator(operator, u)
    settled = slice(operator.settling_samples, None)
    # A rate-dependent play lets go when the motion slows down, so only motions at one speed are compared.
    same_speed = np.isclose(np.diff(u)[1:], np.diff(u)[:-1]) | (getattr(operator, "beta", 0.0) == 0)
    moves = (np.diff(u) * np.diff(theta))[1:][same_speed]
    assert np.all(moves[settled] >= -1e-9)


@given(points=st.lists(st.floats(30.0, 80.0), min_size=2, max_size=6))
def test_backlash_after_its_inverse_is_the_identity(points: list[float]) -> None:
    theta = polyline(points, 9)
    touching = theta[0] / BACKLASH.m_up - BACKLASH.c_up  # the command at which the loading line shows theta[0]
    commands = run_operator(BACKLASH.inverse(), theta, seen=touching)
    np.testing.assert_allclose(run_operator(BACKLASH, commands, seen=theta[0]), theta, atol=1e-9)


@given(points=corners)
def test_static_inverse_after_prandtl_ishlinskii_is_the_identity(points: list[float]) -> None:
    """Both start from the virgin state at the first command, where every play is centred."""
    u = polyline(points, 9)
    total = STATIC_PI.a0 + sum(STATIC_PI.weights)
    theta = run_operator(STATIC_PI, u, seen=total * u[0] + STATIC_PI.b)
    np.testing.assert_allclose(run_operator(STATIC_PI.inverse(), theta, seen=u[0]), u, atol=1e-9)


def test_backlash_is_the_three_branch_recursion_of_the_paper() -> None:
    """S2 eq. (1)-(2), written out branch by branch."""
    u = 3 - 3 * np.cos(2 * np.pi * 0.3 * np.arange(0, 20, DT)) * np.exp(-0.1 * np.arange(0, 20, DT))
    y, expected = 30.0, []
    for command in u:
        if command <= y / BACKLASH.m_lo - BACKLASH.c_lo:
            y = BACKLASH.m_lo * (command + BACKLASH.c_lo)
        elif command >= y / BACKLASH.m_up - BACKLASH.c_up:
            y = BACKLASH.m_up * (command + BACKLASH.c_up)
        expected.append(y)
    np.testing.assert_allclose(run_operator(BACKLASH, u, seen=30.0), expected, atol=1e-12)


def test_lag_reaches_63_percent_after_one_time_constant() -> None:
    step = np.concatenate([[0.0], np.ones(50)])
    assert run_operator(Lag(0.4), step)[10] == pytest.approx(1 - np.exp(-1), abs=1e-12)


@pytest.mark.parametrize(("seconds", "expected"), [(0.08, [0, 0, 0, 1, 1]), (0.06, [0, 0, 0.5, 1, 1])])
def test_delay_shifts_by_samples_and_interpolates_between(seconds: float, expected: list[float]) -> None:
    step = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(run_operator(Delay(seconds, 3), step), expected, atol=1e-12)


@pytest.mark.parametrize("operator", EXAMPLES, ids=lambda o: o.name)
def test_values_and_specification_round_trip(operator: Operator) -> None:
    assert operator.with_values(operator.values) == operator
    assert operator_from(operator_spec(operator), "here") == operator
    assert len(operator.values) == len(operator.parameters)
    assert Chain(operator).state_size == len(operator.states)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"operator": "backlsh", "parameters": {}}, "did you mean 'backlash'"),
        ({"operator": "lag", "parameters": {}}, "lacks tau_s"),
        ({"operator": "lag", "parameters": {"tau": 1.0}}, "did you mean 'tau_s'"),
        ({"operator": "lag", "parameters": {"tau_s": -1.0}}, "expected 1e-06 to 1000"),
        ({"operator": "lag", "parameters": {"tau_s": float("nan")}}, "is nan s"),
        ({"operator": "lag", "parameters": {"tau_s": "fast"}}, "expected a mapping of numbers"),
        ({"operator": "delay", "parameters": {"delay_s": 0.1}}, "delay.samples is None"),
        ({"operator": "lag", "parametres": {}}, "did you mean 'parameters'"),
        ("lag", "expected a mapping with the key 'operator'"),
    ],
)
def test_a_wrong_specification_is_one_clear_line(spec: object, message: str) -> None:
    with pytest.raises(ModelError, match=r"^sim.yaml: chain.core: ") as error:
        operator_from(spec, "sim.yaml: chain.core")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
