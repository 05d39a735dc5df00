"""The engine computes what CasADi computes: drawn expressions, every operation, every level of vector instructions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.core.build import levels
from hystmpc.core.chain import ChainCode, PreparedChain
from hystmpc.core.library import engine
from hystmpc.models.program import BINARY, UNARY, dense
from hystmpc.models.stages import function_program

DT = 0.01
STATES, PARAMETERS = 3, 2
BY_TWO = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / (1.5 + b * b),
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: ca.floor(a) == ca.floor(b),
    "ne": lambda a, b: ca.floor(a) != ca.floor(b),
    "and": lambda a, b: ca.logic_and(a > 0, b > 0),
    "or": lambda a, b: ca.logic_or(a > 0, b > 0),
    "if_else_zero": lambda a, b: ca.if_else(a > b, a, b),
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "pow": lambda a, b: (1.1 + a * a) ** ca.fmin(ca.fmax(b, -3), 3),
}
BY_ONE = {
    "neg": lambda a: -a,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "sqrt": lambda a: ca.sqrt(1 + a * a),
    "sq": lambda a: ca.tanh(a) ** 2,
    "twice": lambda a: a + a,
    "inv": lambda a: 1 / (2 + a * a),
    "not": lambda a: ca.logic_not(a > 0),
    "exp": lambda a: ca.exp(ca.fmin(a, 2)),
    "log": lambda a: ca.log(1 + a * a),
    "tanh": ca.tanh,
    "sin": ca.sin,
    "cos": ca.cos,
    "floor": ca.floor,
    "assign": lambda a: a + 0,
}
draws = st.lists(
    st.tuples(st.sampled_from([*BY_TWO, *BY_ONE]), st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=30
)


def test_every_operation_is_drawn() -> None:
    assert {*BY_TWO, *BY_ONE} == {*BINARY, *UNARY}


def step_of(drawn: Sequence[tuple[str, int, int]]) -> ca.Function:
    """(x, u, p, dt) -> (y, x') from drawn operations on what is there by then."""
    x, u, p, dt = ca.SX.sym("x", STATES), ca.SX.sym("u"), ca.SX.sym("p", PARAMETERS), ca.SX.sym("dt")
    values: list[Any] = [*ca.vertsplit(x), u, *ca.vertsplit(p), dt, ca.SX(0.5)]
    for name, i, j in drawn:
        a, b = values[i % len(values)], values[j % len(values)]
        values.append(BY_TWO[name](a, b) if name in BY_TWO else BY_ONE[name](a))
    shown = [ca.tanh(0.3 * value) for value in values[-STATES - 1 :]]  # bounded, so that a run stays finite
    return dense("step", [x, u, p, dt], [shown[-1] + values[0], ca.vertcat(*shown[:STATES])])


def run_by_casadi(step: ca.Function, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (T,) and the last state."""
    y = np.empty(u.size)
    for t, command in enumerate(u):
        shown, x = (np.asarray(part).ravel() for part in step(x, command, p, DT))
        y[t] = shown[0]
    return y, x


@given(draws)
@settings(max_examples=60, deadline=None)
def test_a_drawn_step_runs_as_casadi_runs_it(drawn: list[tuple[str, int, int]]) -> None:
    """One row, some rows, and one sample at a time, over more samples than a block has."""
    step = step_of(drawn)
    p, rng = np.array([0.7, -1.2]), np.random.default_rng(3)
    u, x = rng.uniform(-2, 2, (6, 150)), rng.uniform(-1, 1, (6, STATES))
    expected = [run_by_casadi(step, x[n], u[n], p) for n in range(2)]
    run = PreparedChain(ChainCode([function_program(step)]), p, DT)
    for rows in (1, 6):
        angles, last = run.run(x[:rows], u[:rows])
        for n in range(min(rows, 2)):
            np.testing.assert_allclose(angles[n], expected[n][0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(last[n], expected[n][1], rtol=1e-9, atol=1e-9)
    y, following = run.step(x[0], u[0, 0])
    shown, after = (np.asarray(part).ravel() for part in step(x[0], u[0, 0], p, DT))
    np.testing.assert_allclose([y, *following], [*shown, *after], rtol=1e-12, atol=1e-12)


@given(draws, draws)
@settings(max_examples=40, deadline=None)
def test_a_jacobian_is_the_sensitivity_to_each_command(
    first: list[tuple[str, int, int]], second: list[tuple[str, int, int]]
) -> None:
    """To the last bit, through two steps in series, over more samples than a block has."""
    code = ChainCode([function_program(step_of(drawn)) for drawn in (first, second)])
    kept, rng = code.prepare(np.array([[0.7], [-1.2], [0.4], [0.9]]), DT), np.random.default_rng(7)
    for samples in (1, 2, 21, 261):
        x, u = rng.uniform(-1, 1, code.states), rng.uniform(-2, 2, samples)
        no_seeds, at_rest = np.zeros((code.parameters, samples)), np.zeros((code.states, 1, samples))
        ends = np.array([0, samples], dtype=np.intc)
        y, by = code.differentiate(kept, ends, u, np.eye(samples), no_seeds, x.reshape(-1, 1), at_rest)
        angles, jacobian = code.linearise(kept, x, u)
        np.testing.assert_array_equal(angles, y)
        np.testing.assert_array_equal(jacobian, by)


@pytest.mark.parametrize("level", levels())
def test_every_level_gives_the_same_bits(level: str) -> None:
    if level != "plain" and int(level[1:]) > engine("plain").level():
        pytest.skip(f"this processor has no {level}")
    drawn = [(name, 3 * k + 1, 5 * k + 2) for k, name in enumerate([*BY_TWO, *BY_ONE])]
    code = ChainCode([function_program(step_of(drawn))])
    rng = np.random.default_rng(5)
    u, x = rng.uniform(-2, 2, (10, 80)), rng.uniform(-1, 1, (10, STATES))
    plain, here = ChainCode(code.stages), ChainCode(code.stages)
    plain.functions, here.functions = engine("plain"), engine(level)
    results = [PreparedChain(one, np.array([0.7, -1.2]), DT) for one in (plain, here)]
    for a, b in zip(results[0].run(x, u), results[1].run(x, u), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(results[0].linearise(x[0], u[0, :20]), results[1].linearise(x[0], u[0, :20]), strict=True):
        np.testing.assert_array_equal(a, b)
