"""A chain of two axes, coupled before and after the hysteresis: the engine against CasADi's own equation."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hystmpc.core.chain import ChainCode
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.hysteresis import Play
from hystmpc.models.operators.operator import Operator
from hystmpc.models.program import dense
from hystmpc.models.stages import function_program, operator_program

DT = 0.02
SAMPLES, ROWS = 170, 5
PLAYS: tuple[Operator, ...] = (Play(0.4), Play(0.7))
LAGS: tuple[Operator, ...] = (Lag(0.05), Lag(0.11))
PULL = np.array([[1.0, 0.2], [-0.1, 0.9]])
TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def coupling(matrix: np.ndarray) -> ca.Function:
    """Step without a state, y = M u; the entries of M are its parameters."""
    x, u, p, dt = ca.SX.sym("x", 0), ca.SX.sym("u", 2), ca.SX.sym("p", 4), ca.SX.sym("dt")
    return dense("coupling", [x, u, p, dt], [ca.reshape(p, 2, 2).T @ u, x])


def two_axes() -> tuple[ChainCode, np.ndarray]:
    """The chain and its parameters: pull, plays, lags, turn."""
    stages = [function_program(coupling(PULL)), *map(operator_program, PLAYS), *map(operator_program, LAGS)]
    stages.append(function_program(coupling(TURN)))
    wires = [((0, 1), (2, 3)), ((2,), (4,)), ((3,), (5,)), ((4,), (6,)), ((5,), (7,)), ((6, 7), (8, 9))]
    values = [*PULL.ravel(), *(v for o in (*PLAYS, *LAGS) for v in o.values), *TURN.ravel()]
    return ChainCode(stages, wires, [8, 9]), np.array(values)


def by_casadi() -> ca.Function:
    """(state (4), u (2), p (12)) -> (y (2), next state, derivatives of both by state, u and p)."""
    x, u, p = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("p", 12)
    signal = ca.reshape(p[:4], 2, 2).T @ u
    following, axes = [], []
    for k, operator in enumerate((*PLAYS, *LAGS)):
        passing = signal[k] if k < 2 else axes[k - 2]
        after, y = operator.equation(x[k], passing, p[4 + k], DT)
        following.append(after)
        axes.append(y)
    shown = ca.reshape(p[8:], 2, 2).T @ ca.vertcat(*axes[2:])
    next_state = ca.vertcat(*following)
    slopes = [ca.jacobian(part, by) for part in (shown, next_state) for by in (x, u, p)]
    return dense("step", [x, u, p], [shown, next_state, *slopes])


def commands(rows: int) -> np.ndarray:
    """Commands (2, T, N) with reversals."""
    t = DT * np.arange(SAMPLES)[:, None] + np.linspace(0, 2, rows)
    return np.array([2 * np.sin(3 * t) + 0.3 * np.sin(17 * t), 1.5 * np.cos(2.1 * t)])


def test_free_runs_are_those_of_the_equation() -> None:
    chain, p = two_axes()
    assert (chain.inputs, chain.outputs, chain.states, chain.parameters) == (2, 2, 4, 12)
    u, states = commands(ROWS), np.linspace(-1, 1, 4 * ROWS).reshape(4, ROWS)
    expected, step = np.empty((2, SAMPLES, ROWS)), by_casadi()
    after = states.copy()
    for n in range(ROWS):
        for t in range(SAMPLES):
            y, x = (np.asarray(part).ravel() for part in step(after[:, n], u[:, t, n], p)[:2])
            expected[:, t, n], after[:, n] = y, x
    angles = chain.simulate(chain.prepare(p[:, None], DT), states, u)
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(states, after, rtol=0, atol=1e-12)


def test_derivatives_are_those_of_the_chain_rule() -> None:
    """By all parameters, and by both commands of one sample, which is the Jacobian of a plan."""
    chain, p = two_axes()
    u, acted = np.ascontiguousarray(commands(1)[:, :, 0]), 40
    directions = p.size + 2
    seeds, du = np.zeros((p.size, directions)), np.zeros((2, SAMPLES, directions))
    seeds[:, : p.size] = np.eye(p.size)
    du[0, acted, p.size] = du[1, acted, p.size + 1] = 1.0
    start = np.array([0.3, -0.2, 0.1, 0.0])
    y, dy = chain.differentiate(
        chain.prepare(p[:, None], DT), np.array([0, SAMPLES], dtype=np.intc), u, du, seeds, start[:, None].copy(),
        np.zeros((4, 1, directions)),
    )  # fmt: skip
    state, slope, step = start, np.zeros((4, directions)), by_casadi()
    for t in range(SAMPLES):
        shown, following, yx, yu, yp, xx, xu, xp = (np.asarray(part) for part in step(state, u[:, t], p))
        np.testing.assert_allclose(y[:, t], shown.ravel(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(dy[:, t], yx @ slope + yu @ du[:, t] + yp @ seeds, rtol=0, atol=1e-11)
        state, slope = following.ravel(), xx @ slope + xu @ du[:, t] + xp @ seeds
