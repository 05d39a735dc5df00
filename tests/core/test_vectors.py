"""Two commands, two angles and an input that is measured: one chain through step, free run, roll-out, Jacobian, program
and ONNX graph, each against CasADi's own equation."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.optimize import nnls

from hystmpc.core.chain import ChainCode
from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, struct
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.law_tables import law_over
from hystmpc.ctrl.linearised.program import PlanningTask, PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, QpData
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.models.contract.casadi_ import to_casadi
from hystmpc.models.contract.export import graph_bytes
from hystmpc.models.contract.load import GraphSizes, check_graph, load_onnx, open_session
from hystmpc.models.contract.onnx_nodes import step_graph
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.hysteresis import Play
from hystmpc.models.operators.operator import Operator
from hystmpc.models.program import dense
from hystmpc.models.stages import chain_code, function_program, operator_program
from hystmpc.trials.errors import ModelError

from ..models.contract_examples import metadata

DT = 0.02
SAMPLES, ROWS, H = 170, 5, 12
PLAYS: tuple[Operator, ...] = (Play(0.4), Play(0.7))
LAGS: tuple[Operator, ...] = (Lag(0.05), Lag(0.11))
PULL, BY_PRESSURE = np.array([[1.0, 0.2], [-0.1, 0.9]]), 0.15
TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
START = np.array([0.3, -0.2, 0.1, 0.0])


def pulled(u: ca.SX, p: ca.SX) -> ca.SX:
    """Coupling before the plays, whose gain the measured pressure u_3 scales: (1 + c u_3) M (u_1, u_2), p = (M, c)."""
    return (1 + p[4] * u[2]) * (ca.reshape(p[:4], 2, 2).T @ u[:2])


def turned(u: ca.SX, p: ca.SX) -> ca.SX:
    """Coupling behind the lags: M u."""
    return ca.reshape(p, 2, 2).T @ u


def coupling(inputs: int, parameters: int, equation: object) -> ca.Function:
    """Step without a state."""
    x, u, p, dt = ca.SX.sym("x", 0), ca.SX.sym("u", inputs), ca.SX.sym("p", parameters), ca.SX.sym("dt")
    return dense("coupling", [x, u, p, dt], [equation(u, p), x])  # type: ignore[operator]


def two_axes(
    pull: np.ndarray = PULL, by_pressure: float = BY_PRESSURE, turn: np.ndarray = TURN
) -> tuple[ChainCode, np.ndarray]:
    """The chain and its parameters: pull, plays, lags, turn."""
    stages = [function_program(coupling(3, 5, pulled)), *map(operator_program, (*PLAYS, *LAGS))]
    stages.append(function_program(coupling(2, 4, turned)))
    wires = [((0, 1, 2), (3, 4)), ((3,), (5,)), ((4,), (6,)), ((5,), (7,)), ((6,), (8,)), ((7, 8), (9, 10))]
    values = [*pull.ravel(), by_pressure, *(v for o in (*PLAYS, *LAGS) for v in o.values), *turn.ravel()]
    return ChainCode(stages, wires, [9, 10], scheduled=1), np.array(values)


def equation(x: ca.SX, u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Angles (2) and next state (4) of state (4), inputs (3) and parameters (13)."""
    signal, following, axes = pulled(u, p[:5]), [], []
    for k, operator in enumerate((*PLAYS, *LAGS)):
        after, y = operator.equation(x[k], signal[k] if k < 2 else axes[k - 2], p[5 + k], DT)
        following.append(after)
        axes.append(y)
    return turned(ca.vertcat(*axes[2:]), p[9:]), ca.vertcat(*following)


@cache
def by_casadi() -> ca.Function:
    """(state, inputs, parameters) -> (angles, next state, derivatives of both by state, inputs and parameters)."""
    x, u, p = ca.SX.sym("x", 4), ca.SX.sym("u", 3), ca.SX.sym("p", 13)
    shown, after = equation(x, u, p)
    slopes = [ca.jacobian(part, by) for part in (shown, after) for by in (x, u, p)]
    return dense("step", [x, u, p], [shown, after, *slopes])


def run_by_casadi(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (2, T) under inputs (3, T), and the last state."""
    angles = np.empty((2, u.shape[1]))
    for t in range(u.shape[1]):
        angles[:, t], x = (np.asarray(part).ravel() for part in by_casadi()(x, u[:, t], p)[:2])
    return angles, x


def signals(rows: int) -> np.ndarray:
    """Commands with reversals, and the pressure: (3, T, N)."""
    t = DT * np.arange(SAMPLES)[:, None] + np.linspace(0, 2, rows)
    return np.array([2 * np.sin(3 * t) + 0.3 * np.sin(17 * t), 1.5 * np.cos(2.1 * t), 1 + np.sin(0.9 * t)])


def drawn(seed: int, rows: int = ROWS, size: int = H) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A state (4,), plans (N, 2, H) of random moves, and a measured input (H,)."""
    random = np.random.default_rng(seed)
    return (
        random.normal(0, 1, 4),
        np.cumsum(random.normal(0, 0.4, (rows, 2, size)), axis=2),
        random.uniform(-1, 2, size),
    )


def test_free_runs_are_those_of_the_equation() -> None:
    chain, p = two_axes()
    assert (chain.inputs, chain.scheduled, chain.outputs, chain.states, chain.parameters) == (3, 1, 2, 4, 13)
    u, states = signals(ROWS), np.linspace(-1, 1, 4 * ROWS).reshape(4, ROWS)
    runs = [run_by_casadi(states[:, n], u[:, :, n], p) for n in range(ROWS)]
    angles = chain.simulate(chain.prepare(p[:, None], DT), states, u)
    np.testing.assert_allclose(angles, np.stack([run[0] for run in runs], axis=2), rtol=0, atol=1e-12)
    np.testing.assert_allclose(states, np.stack([run[1] for run in runs], axis=1), rtol=0, atol=1e-12)


@given(seed=st.integers(0, 10**6))
def test_steps_free_run_and_roll_out_are_one(seed: int) -> None:
    """To the last bit, and those of the equation; one pressure for all plans. 70 samples are several blocks."""
    chain, p = two_axes()
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(seed, size=70)
    rolled = chain.roll_out(kept, x, plans, pressure)
    u = np.concatenate([plans, np.tile(pressure, (ROWS, 1, 1))], axis=1).transpose(1, 2, 0).copy()
    states = np.repeat(x[:, None], ROWS, axis=1)
    by_step = np.concatenate([chain.simulate(kept, states, u[:, k : k + 1].copy()) for k in range(70)], axis=1)
    np.testing.assert_array_equal(rolled, by_step.transpose(2, 0, 1))
    run = chain.simulate(kept, np.repeat(x[:, None], ROWS, axis=1), u)
    np.testing.assert_array_equal(run, by_step)
    np.testing.assert_allclose(rolled[0], run_by_casadi(x, u[:, :, 0], p)[0], rtol=0, atol=1e-12)


def test_derivatives_are_those_of_the_chain_rule() -> None:
    """By all parameters, and by the inputs of one sample."""
    chain, p = two_axes()
    u, acted = np.ascontiguousarray(signals(1)[:, :, 0]), 40
    directions = p.size + 3
    seeds, du = np.zeros((p.size, directions)), np.zeros((3, SAMPLES, directions))
    seeds[:, : p.size] = np.eye(p.size)
    du[range(3), acted, range(p.size, directions)] = 1.0
    y, dy = chain.differentiate(
        chain.prepare(p[:, None], DT), np.array([0, SAMPLES], dtype=np.intc), u, du, seeds, START[:, None].copy(),
        np.zeros((4, 1, directions)),
    )  # fmt: skip
    state, slope, step = START, np.zeros((4, directions)), by_casadi()
    for t in range(SAMPLES):
        shown, following, yx, yu, yp, xx, xu, xp = (np.asarray(part) for part in step(state, u[:, t], p))
        np.testing.assert_allclose(y[:, t], shown.ravel(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(dy[:, t], yx @ slope + yu @ du[:, t] + yp @ seeds, rtol=0, atol=1e-11)
        state, slope = following.ravel(), xx @ slope + xu @ du[:, t] + xp @ seeds


@given(seed=st.integers(0, 10**6))
def test_the_jacobian_is_that_of_the_roll_out_by_the_commands_alone(seed: int) -> None:
    chain, p = two_axes()
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(seed, 1)
    angles, jacobian = chain.linearise(kept, x, plans[0], pressure)
    np.testing.assert_array_equal(angles, chain.roll_out(kept, x, plans, pressure)[0])
    assert jacobian.shape == (2, H, 2, H)
    u, slope = np.vstack([plans[0], pressure]), np.zeros((4, 2 * H))
    for t in range(H):
        after, yx, yu, _, xx, xu, _ = (np.asarray(part) for part in by_casadi()(x, u[:, t], p)[1:])
        moved = np.kron(np.eye(2), np.eye(H)[t])
        expected = yx @ slope + yu[:, :2] @ moved
        np.testing.assert_allclose(jacobian[:, t].reshape(2, -1), expected, rtol=0, atol=1e-12)
        x, slope = after.ravel(), xx @ slope + xu[:, :2] @ moved
    assert not np.any(np.where(np.tri(H, dtype=bool)[:, None], 0.0, jacobian))  # a command acts from its sample on


@given(seed=st.integers(0, 10**6))
def test_the_jacobian_is_that_of_differences(seed: int) -> None:
    """Away from the edges of the plays, where a small step does not change the branch."""
    chain, p = two_axes()
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(seed, 1)
    jacobian = chain.linearise(kept, x, plans[0], pressure)[1].reshape(2 * H, 2 * H)
    nudge = 1e-6
    steps = nudge * np.eye(2 * H).reshape(-1, 2, H)
    up, down = (chain.roll_out(kept, x, plans[0] + side * steps, pressure) for side in (1, -1))
    same = np.abs(up + down - 2 * chain.roll_out(kept, x, plans, pressure)) < 1e-12
    differences = ((up - down) / (2 * nudge)).reshape(2 * H, 2 * H).T
    smooth = same.reshape(2 * H, 2 * H).T
    assert smooth.mean() > 0.95
    np.testing.assert_allclose(jacobian[smooth], differences[smooth], rtol=0, atol=1e-8)


def test_axes_that_are_not_coupled_are_two_single_axes_to_the_last_bit() -> None:
    chain, p = two_axes(np.eye(2), 0.0, np.eye(2))
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(3)
    rolled, (angles, jacobian) = (
        chain.roll_out(kept, x, plans, pressure),
        chain.linearise(kept, x, plans[0], pressure),
    )
    for axis in range(2):
        operators = PLAYS[axis], LAGS[axis]
        single = chain_code(operators)
        alone = single.prepare(np.array([[v] for o in operators for v in o.values]), DT)
        state = x[axis::2].copy()
        np.testing.assert_array_equal(rolled[:, axis], single.roll_out(alone, state, plans[:, axis].copy()))
        along, slopes = single.linearise(alone, state, plans[0, axis].copy())
        np.testing.assert_array_equal(angles[axis], along)
        np.testing.assert_array_equal(jacobian[axis, :, axis], slopes)
        assert not jacobian[axis, :, 1 - axis].any()


@pytest.mark.parametrize("lost", [np.nan, np.inf, None])
def test_where_a_measured_input_is_lost_no_angle_is_a_number(lost: float | None) -> None:
    """A play alone would hide it: of no number it makes no motion."""
    chain, p = two_axes()
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(1)
    known = None if lost is None else np.where(np.arange(H) == 7, lost, pressure)
    y, dy = np.zeros((ROWS, 2, H)), np.zeros((2, H, 2, H))
    memory = np.empty(engine().chain_bytes(chain.code, ROWS, 0), np.uint8)
    engine().chain_roll_out(chain.code, kept, x, ROWS, H, plans, known, y, memory)
    assert np.isnan(y).all()
    memory, y = np.empty(engine().chain_linearise_bytes(chain.code, H), np.uint8), np.zeros((2, H))
    engine().chain_linearise(chain.code, kept, x, plans[0].copy(), known, H, y, dy, memory)
    assert np.isnan(y).all()
    assert np.isnan(dy).all()


def test_other_inputs_than_those_of_the_chain_are_refused() -> None:
    chain, p = two_axes()
    kept, (x, plans, pressure) = chain.prepare(p[:, None], DT), drawn(1)
    with pytest.raises(ValueError, match=r"scheduled inputs: got shape \(0,\), expected \(12,\)"):
        chain.roll_out(kept, x, plans)
    with pytest.raises(ValueError, match=r"plans: got shape \(5, 12\), expected \(5, 2, 12\)"):
        chain.roll_out(kept, x, plans[:, 0].copy(), pressure)
    with pytest.raises(ValueError, match=r"inputs: got shape \(2, 12, 5\), expected \(3, 12, 5\)"):
        chain.simulate(kept, np.zeros((4, ROWS)), plans.transpose(1, 2, 0).copy())
    with pytest.raises(ValueError, match="counts from zero, or one"):
        ChainCode([operator_program(Lag(0.1))], scheduled=1)


LIMITS = CommandLimits(-1.5, 2.0, 8.0), CommandLimits(-3.0, 1.0, 20.0)
FREE_WEIGHTS = WeightsSettings(rate=0.7, effort=0.02), WeightsSettings(rate=0.2, effort=0.05)
SOFT = {"angle_lower_deg": -0.4, "angle_upper_deg": 0.6}
SOFT_WEIGHTS = WeightsSettings(rate=0.7, effort=0.02), WeightsSettings(rate=0.2, effort=0.05, **SOFT)
BLOCKS = (1, 1, 2, 4), (2, 3, 7)


@cache
def law_of(soft: bool, blocked: bool, axes: tuple[int, ...] = (0, 1)) -> Struct:
    """Law of axes whose limits, weights and blocks differ; the second one has soft limits."""
    law, weights = None, SOFT_WEIGHTS if soft else FREE_WEIGHTS
    for axis in reversed(axes):
        law = law_over(weights[axis], H, LIMITS[axis], DT, BLOCKS[axis] if blocked else None, law)
    assert law is not None
    return law


class Posed:
    """A random task around an admissible plan of the chain, linearised."""

    def __init__(self, seed: int) -> None:
        random, (chain, p) = np.random.default_rng(seed), two_axes()
        x, plans, pressure = drawn(seed, 1)
        self.last = random.uniform(-1, 1, 2)
        clipped = [limits.clip_plans(plans[:, i], self.last[i], DT)[0] for i, limits in enumerate(LIMITS)]
        self.plan = np.array(clipped)
        self.angles, self.jacobian = chain.linearise(chain.prepare(p[:, None], DT), x, self.plan, pressure)
        self.wanted, self.feed = random.normal(0, 1, (2, 2, H))

    def task(self, axes: tuple[int, ...] = (0, 1)) -> PlanningTask:
        task = None
        for i in reversed(axes):
            task = PlanningTask(self.last[i], FREE_WEIGHTS[i].rate, self.wanted[i], self.feed[i], (-0.4, 0.6), task)
        assert task is not None
        return task

    def data(self, law: Struct) -> QpData:
        return PlanProgram(law).data(self.task(), self.plan, self.angles, self.jacobian)


def solved(data: QpData) -> np.ndarray:
    unknowns, rows = data.columns.shape
    room = np.empty(engine().qp_bytes(unknowns, rows, int(np.count_nonzero(data.soft))), np.uint8)
    primal = np.empty(unknowns)
    given = data.hessian, data.gradient, data.columns, data.lower, data.upper, data.soft
    assert engine().quadratic_program(unknowns, rows, *given, 500, room, primal) >= 0
    return primal


POSED = {"seed": st.integers(0, 10**6), "soft": st.booleans(), "blocked": st.booleans()}


@given(**POSED)
def test_the_program_is_that_of_the_cost(seed: int, soft: bool, blocked: bool) -> None:
    """P and q as in the class, rows by their meaning: of every command, move, and angle with soft limits."""
    posed, law = Posed(seed), law_of(soft, blocked)
    data, weights = posed.data(law), SOFT_WEIGHTS if soft else FREE_WEIGHTS
    program = PlanProgram(law)
    m = data.gradient.size
    basis = np.array([program.deviation(unit) for unit in np.eye(m)]).T  # (2 H, m)
    slopes = posed.jacobian.reshape(2 * H, 2 * H) @ basis
    tracking = np.diag(np.concatenate([w.over(H) for w in weights]))
    moving = block_diag(*[np.eye(H) - np.eye(H, k=-1)] * 2)
    rate, effort = (np.diag(np.repeat([getattr(w, name) for w in weights], H)) for name in ("rate", "effort"))
    moves = moving @ posed.plan.ravel() - np.kron(posed.last, np.eye(H)[0])
    hessian = 2 * (slopes.T @ tracking @ slopes + basis.T @ (moving.T @ rate @ moving + effort) @ basis)
    gradient = 2 * slopes.T @ tracking @ (posed.angles - posed.wanted).ravel()
    gradient += 2 * basis.T @ (moving.T @ rate @ moves + effort @ (posed.plan - posed.feed).ravel())
    np.testing.assert_allclose(np.tril(data.hessian), np.tril(hessian), rtol=0, atol=1e-11 * np.abs(hessian).max())
    np.testing.assert_allclose(data.gradient, gradient, rtol=0, atol=1e-11 * np.abs(gradient).max())
    assert data.lower.size == 2 * H + m + H * soft
    rows = np.sort_complex(data.columns.T @ np.linspace(1, 2, m) + 1j * data.upper)
    commands = basis @ np.linspace(1, 2, m) + 1j * (
        np.repeat([limit.upper for limit in LIMITS], H) - posed.plan.ravel()
    )
    assert np.isin(np.round(commands, 9), np.round(rows, 9)).all()
    shown = slopes[H:] @ np.linspace(1, 2, m) + 1j * (0.6 - posed.angles[1])
    assert soft == bool(np.isin(np.round(shown, 9), np.round(rows, 9)).all())


@given(**POSED)
def test_its_solution_obeys_the_limits_and_is_optimal(seed: int, soft: bool, blocked: bool) -> None:
    """Karush, Kuhn and Tucker: -(P z + q + A' s / c) is a sum of active rows, each pushed inwards."""
    posed, law = Posed(seed), law_of(soft, blocked)
    data, program = posed.data(law), PlanProgram(law)
    z = solved(data)
    along, hard = data.columns.T @ z, data.soft == 0
    assert np.all(along[hard] >= data.lower[hard] - 1e-6)
    assert np.all(along[hard] <= data.upper[hard] + 1e-6)
    hessian = np.tril(data.hessian) + np.tril(data.hessian, -1).T
    excess = np.where(hard, 0.0, along - np.clip(along, data.lower, data.upper))
    left = -(hessian @ z + data.gradient + data.columns @ (excess / np.where(hard, 1.0, data.soft)))
    up, down = hard & (along > data.upper - 1e-6), hard & (along < data.lower + 1e-6)
    scale = 1.0 + np.abs(data.gradient).max()
    inwards = np.hstack([data.columns[:, up], -data.columns[:, down], np.zeros((z.size, 1))])
    assert nnls(inwards, left)[1] < 1e-7 * scale
    planned = program.after(posed.task(), posed.plan, posed.angles, posed.jacobian, z)
    for i, (limits, plan) in enumerate(zip(LIMITS, planned[:-1].reshape(2, H), strict=True)):
        assert np.all((limits.lower <= plan) & (plan <= limits.upper))
        assert np.all(np.abs(np.diff(plan, prepend=posed.last[i])) <= limits.rate * DT * (1 + 1e-12))
    np.testing.assert_allclose(planned[:-1], posed.plan.ravel() + program.deviation(z), rtol=0, atol=1e-5)
    angles = posed.angles.ravel() + posed.jacobian.reshape(2 * H, -1) @ (planned[:-1] - posed.plan.ravel())
    np.testing.assert_allclose(planned[-1], cost(posed, soft, planned[:-1], angles), rtol=1e-9)


def cost(posed: Posed, soft: bool, plan: np.ndarray, angles: np.ndarray) -> float:
    """The planning cost, once more."""
    total = 0.0
    for i, weights in enumerate(SOFT_WEIGHTS if soft else FREE_WEIGHTS):
        u, y = plan.reshape(2, H)[i], angles.reshape(2, H)[i]
        terms = weights.over(H) * (y - posed.wanted[i]) ** 2 + weights.effort * (u - posed.feed[i]) ** 2
        total += np.sum(terms + weights.rate * np.diff(u, prepend=posed.last[i]) ** 2)
        if weights.limits_angle:
            total += weights.soft_limit * np.sum((y - np.clip(y, -0.4, 0.6)) ** 2)
    return float(total)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("blocked", [False, True])
def test_osqp_finds_the_same_solution(soft: bool, blocked: bool) -> None:
    posed, law = Posed(11), law_of(soft, blocked)
    data, program = posed.data(law), PlanProgram(law)
    answer = OsqpOptions(eps=1e-10, iterations=50000).solver(program.pattern).solve(data)
    assert answer.status == "solved"
    np.testing.assert_allclose(answer.primal, solved(data), rtol=0, atol=1e-5)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("blocked", [False, True])
def test_the_program_of_axes_that_are_not_coupled_is_both_programs_to_the_last_bit(soft: bool, blocked: bool) -> None:
    posed = Posed(5)
    posed.jacobian = posed.jacobian * np.eye(2)[:, None, :, None]
    data = posed.data(law_of(soft, blocked))
    alone = [
        PlanProgram(law_of(soft, blocked, (i,))).data(
            posed.task((i,)), posed.plan[i], posed.angles[i], posed.jacobian[i, :, i]
        )
        for i in range(2)
    ]
    np.testing.assert_array_equal(np.tril(data.hessian), np.tril(block_diag(*(one.hessian for one in alone))))
    np.testing.assert_array_equal(data.columns, block_diag(*(one.columns for one in alone)))
    for name in ("gradient", "lower", "upper", "soft", "dual"):
        np.testing.assert_array_equal(getattr(data, name), np.concatenate([getattr(one, name) for one in alone]))
    np.testing.assert_allclose(solved(data), np.concatenate([solved(one) for one in alone]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("blocked", [False, True])
def test_commands_and_angles_need_not_be_as_many(blocked: bool) -> None:
    """Two commands of one angle, and one command of two angles: rows and columns of the 2 x 2 program."""
    posed, whole = Posed(8), law_of(False, blocked)
    second = whole.fields["next"].fields
    two_commands = struct(
        "hystmpc_law", **{**whole.fields, "next": struct("hystmpc_law", **{**second, "tracking": None})}
    )
    two_angles = struct("hystmpc_law", **{**whole.fields, "next": struct("hystmpc_law", **{**second, "moves": 0})})
    full = posed.data(law_of(False, blocked))
    m = whole.fields["moves"]
    untracked = posed.jacobian.copy()
    untracked[1] = 0.0
    commands = PlanProgram(two_commands).data(posed.task(), posed.plan, posed.angles[:1], posed.jacobian[:1])
    expected = PlanProgram(whole).data(posed.task(), posed.plan, posed.angles, untracked)
    np.testing.assert_array_equal(np.tril(commands.hessian), np.tril(expected.hessian))
    np.testing.assert_array_equal(commands.gradient, expected.gradient)
    np.testing.assert_array_equal(commands.columns, full.columns)
    angles = PlanProgram(two_angles).data(posed.task(), posed.plan[:1], posed.angles, posed.jacobian[:, :, :1])
    np.testing.assert_array_equal(np.tril(angles.hessian), np.tril(full.hessian)[:m, :m])
    np.testing.assert_array_equal(angles.gradient, full.gradient[:m])
    np.testing.assert_array_equal(angles.columns, full.columns[:m, : H + m])


def graph() -> onnx.GraphProto:
    """Step graph of the chain."""
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 3)
    shown, after = equation(x, u, ca.DM(two_axes()[1]))
    return step_graph(dense("step", [x, u], [shown, after]), "two_axes")


def test_its_graph_is_the_chain(tmp_path: Path) -> None:
    """u [N,3] and theta [N,2] in onnxruntime and CasADi; a loader of one axis refuses the file in one line."""
    content = graph_bytes(graph(), metadata(size=4))
    proto = onnx.load_model_from_string(content)
    sizes = check_graph(proto, 4, "file")
    assert sizes == GraphSizes(np.dtype(np.float64), 4, 3, 2)
    session, function = open_session(content, sizes, "file"), to_casadi(proto.graph)
    chain, p = two_axes()
    kept, random = chain.prepare(p[:, None], DT), np.random.default_rng(0)
    states, u = random.normal(0, 1, (64, 4)), random.normal(0, 1, (64, 3))
    moved = states.T.copy()
    expected = chain.simulate(kept, moved, np.ascontiguousarray(u.T[:, None]))[:, 0]
    theta, following = session.run(["theta", "next_state"], {"u": u, "state": states})
    np.testing.assert_allclose(theta.T, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(following.T, moved, rtol=0, atol=1e-12)
    along, after = (np.asarray(part) for part in function(states.T, u.T))
    np.testing.assert_allclose(along, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(after, moved, rtol=0, atol=1e-12)
    (tmp_path / "two.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"has 3 inputs and 2 outputs, expected one command and one angle[^\n]*$"):
        load_onnx(tmp_path / "two.onnx")


def test_an_output_that_is_a_number_is_a_column() -> None:
    x, u = ca.SX.sym("x", 1), ca.SX.sym("u", 2)
    content = graph_bytes(
        step_graph(dense("step", [x, u], [ca.vertcat(u[0] - u[1], 3.0), x]), "step"), metadata(size=1)
    )
    session = open_session(content, check_graph(onnx.load_model_from_string(content), 1, "file"), "file")
    (theta,) = session.run(["theta"], {"u": np.array([[2.0, 1.0], [5.0, 1.0]]), "state": np.zeros((2, 1))})
    np.testing.assert_array_equal(theta, [[1.0, 3.0], [4.0, 3.0]])
