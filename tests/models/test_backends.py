"""One equation, three backends: CasADi, the engine and ONNX give one result."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from hystmpc.core.chain import ChainCode, PreparedChain
from hystmpc.models.chain import Chain, operators
from hystmpc.models.contract.onnx_nodes import step_graph
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.program import dense, instructions
from hystmpc.models.stages import chain_code, function_program, prepared
from hystmpc.trials.errors import ModelError

from .zoo import CHAINS, DT, EXAMPLES, WITH_EFFECTS

BY_INPUTS = CHAINS["pi by two inputs"]
CASES = [BY_INPUTS, *(Chain(example) for example in EXAMPLES), CHAINS["delayed pi with lag"], WITH_EFFECTS]
IDS = ["inputs", *(f"{example.name}-{k}" for k, example in enumerate(EXAMPLES)), "chain", "effects"]
# Plays, second order, slow memory, a gain by direction, and whole chains: a wrong operation shows in one of these.
FAST = {"prandtl_ishlinskii-8", "servo-22", "creep-31", "asymmetry-42", "inputs", "chain", "effects"}
NAMED = [
    pytest.param(chain, id=name, marks=() if name in FAST else pytest.mark.slow)
    for chain, name in zip(CASES, IDS, strict=True)
]
every_case = pytest.mark.parametrize("chain", NAMED)
# A sensor's derivative is straight-through by intent, not that of its steps: tests/models/test_sensor.py.
smooth = pytest.mark.parametrize("chain", [case for case in NAMED if "sensor" not in str(case.id)])
# One of each operator: what its other forms compute is compared above all backends, and their derivatives in a sample.
ONE_OF_EACH = [*{type(chain.core): case for chain, case in zip(CASES[:-2], NAMED, strict=False)}.values(), *NAMED[-2:]]
BATCH = 40


def points(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """States and inputs around a catheter's operating range, where all branches are met."""
    rng = np.random.default_rng(7)
    return rng.uniform(-1.0, 80.0, (BATCH, chain.state_size)), rng.uniform(0.0, 80.0, (BATCH, 1))


def by_casadi(chain: Chain, states: np.ndarray, u: np.ndarray) -> np.ndarray:
    rows = [chain.transition(x, v, chain.values, DT) for x, v in zip(states, u, strict=True)]
    return np.array([np.concatenate([np.asarray(y).ravel(), np.asarray(x).ravel()]) for y, x in rows])


engine_run = cache(lambda chain: prepared(chain.operators, DT))


def by_engine(chain: Chain, states: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.hstack(engine_run(chain).run(states, u))


def by_engine_one_by_one(chain: Chain, states: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.array([np.append(*engine_run(chain).step(x, float(v[0]))) for x, v in zip(states, u, strict=True)])


def by_engine_as_a_whole(chain: Chain, states: np.ndarray, u: np.ndarray) -> np.ndarray:
    code = ChainCode([function_program(chain.transition)])
    return np.hstack(PreparedChain(code, chain.values, DT).run(states, u))


def one_thread() -> ort.SessionOptions:
    """A pool of threads for a node costs more than all nodes."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return options


def by_onnx(chain: Chain, states: np.ndarray, u: np.ndarray) -> np.ndarray:
    graph = step_graph(chain.bound(DT), "step")
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model)
    session = ort.InferenceSession(model.SerializeToString(), one_thread(), providers=["CPUExecutionProvider"])
    return np.hstack(session.run(["theta", "next_state"], {"u": u, "state": states}))


@every_case
@pytest.mark.parametrize("backend", [by_engine, by_engine_one_by_one, by_engine_as_a_whole, by_onnx])
def test_backends_agree(backend: object, chain: Chain) -> None:
    states, u = points(chain)
    np.testing.assert_allclose(backend(chain, states, u), by_casadi(chain, states, u), rtol=1e-12, atol=1e-10)  # type: ignore[operator]


def test_the_examples_cover_the_catalogue() -> None:
    assert {type(chain.core.inner) for chain in CASES} == set(operators().values())


def test_an_operation_outside_the_list_is_named() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ModelError, match="'erf' at instruction"):
        list(instructions(dense("foreign", [x], [ca.erf(x)])))


def finite_difference(chain: Chain, state: np.ndarray, u: float, step: float = 1e-6) -> np.ndarray:
    """Central differences of (theta, next state) by (state, u)."""
    nudges = step * np.eye(state.size + 1)
    around = np.append(state, u) + np.concatenate([nudges, -nudges])
    ahead, behind = np.split(by_engine(chain, around[:, :-1].copy(), around[:, -1:].copy()), 2)
    return (ahead - behind).T / (2 * step)


@smooth
def test_jacobian_is_that_of_finite_differences_away_from_kinks(chain: Chain) -> None:
    x, u = ca.SX.sym("x", chain.state_size), ca.SX.sym("u")
    theta, following = chain.bound(DT)(x, u)
    jacobian = dense("jacobian", [x, u], [ca.jacobian(ca.vertcat(theta, following), ca.vertcat(x, u))])
    compared = 0
    for state, command in zip(*points(chain), strict=True):
        wide, narrow = (finite_difference(chain, state, command[0], step) for step in (1e-5, 1e-6))
        if np.allclose(wide, narrow, atol=1e-6):  # a kink in between would make them differ
            np.testing.assert_allclose(np.asarray(jacobian(state, command[0])), narrow, atol=1e-6)
            compared += 1
    assert compared >= BATCH // 2


@pytest.mark.parametrize("chain", [case for case in NAMED if case.id in FAST or "oscillator" in str(case.id)])
def test_parameter_sensitivity_is_that_of_finite_differences(chain: Chain) -> None:
    """Those of every operator are the exact ones of CasADi in test_free_run."""
    u = 3 - 3 * np.cos(2 * np.pi * 0.37 * np.arange(0, 6, DT)) + 0.01 * np.sin(np.arange(0, 6, DT))
    # Off round numbers: a delay of a whole number of samples sits on a kink of its own.
    p, code = chain.values * 1.0137 + 1e-3, chain_code(chain.operators)
    state = np.full(chain.state_size, 31.0)

    def run(values: np.ndarray) -> np.ndarray:
        return PreparedChain(code, values, DT).run(state[None], u[None])[0][0]

    theta, gradient = StagedChain(chain).differentiate(u, DT, state[:, None], np.zeros((state.size, 1, p.size)), p)
    np.testing.assert_allclose(theta, run(p), atol=1e-10)
    for j in range(p.size):
        shift = np.zeros(p.size)
        shift[j] = 1e-7
        difference = (run(p + shift) - run(p - shift)) / 2e-7
        assert np.quantile(np.abs(difference - gradient[:, j]), 0.9) <= 1e-5 * max(1.0, np.abs(difference).max())


@pytest.mark.parametrize("chain", ONE_OF_EACH)
def test_linearisation_along_a_plan_is_the_product_of_the_steps(chain: Chain) -> None:
    """The engine's Jacobian of a horizon against the chain rule on CasADi's step derivatives."""
    rng = np.random.default_rng(3)
    plan = np.cumsum(rng.normal(0, 0.3, 12)) + 3.0
    state = np.full(chain.state_size, 2.0)
    theta, jacobian = engine_run(chain).linearise(state, plan)
    x, u = ca.SX.sym("x", chain.state_size), ca.SX.sym("u")
    angle, following = chain.bound(DT)(x, u)
    step = dense("step", [x, u], [angle, following, ca.jacobian(ca.vertcat(angle, following), ca.vertcat(x, u))])
    moving, expected, angles = np.zeros((chain.state_size, 12)), np.zeros((12, 12)), []
    for k, command in enumerate(plan):
        angle, state, by = (np.asarray(part) for part in step(state, command))
        moving[:, k] = 0.0
        full = by[:, :-1] @ moving
        full[:, k] += by[:, -1]
        expected[k], moving = full[0], full[1:]
        angles.append(float(angle[0, 0]))
    np.testing.assert_allclose(theta, angles, atol=1e-10)
    np.testing.assert_allclose(jacobian, expected, atol=1e-9)
