"""Operators connected with a model: a series is a chain, a parallel connection a sum, in every form of the model."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hystmpc.models.chain import Chain, chain_spec
from hystmpc.models.connections import connected_bundle, rest_of
from hystmpc.models.contract.export import ExportBundle, export_onnx, model_bytes
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.contract.metadata import Connection
from hystmpc.models.evaluate import free_run
from hystmpc.models.inverse.drive import Drive, DrivenInverse
from hystmpc.models.motions import probe_commands
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.prediction.build import ParallelPredictor, SeriesPredictor, controller_model, predictor_for
from hystmpc.models.simulator import ChainModel, simulator_bundle
from hystmpc.trials.errors import ModelError
from hystmpc_lab.performance.lstm_reference import LstmStep, lstm_step_graph

from .lstm_examples import facts, random_weights
from .zoo import BACKLASH, DT, RATE_PI, simulator

DRIVE: tuple[Operator, ...] = (Delay(2 * DT, 2), Lag(0.08))
BESIDE = Chain(BACKLASH, before=(Creep((0.15,), (8.0,)),))
WAYS: dict[str, Chain] = {"series": Chain(DRIVE[-1], before=DRIVE[:-1]), "parallel": BESIDE}
RESTS = ("operators", "lstm", "parallel lstm")
Way = Literal["series", "parallel"]


@lru_cache
def rest(name: str) -> ExportBundle:
    """What is connected: a chain in double, a network in single precision, or that with operators beside it."""
    if name == "operators":
        return simulator_bundle(simulator(Chain(RATE_PI)))
    if name == "lstm":
        weights = random_weights(5, 1)
        own = facts(weights)
        return ExportBundle(lstm_step_graph(weights), own, LstmStep(weights), probe_commands(own))
    return connected("parallel", "lstm")


@lru_cache
def connected(way: Way, name: str) -> ExportBundle:
    operators = simulator(WAYS[way])
    return connected_bundle(operators, way, rest(name), operators.metadata())


@lru_cache
def model_of(way: Way, name: str) -> OnnxModel:
    return OnnxModel(model_bytes(connected(way, name)), f"{way} {name}", "conditioned")


CASES = [("series", name) for name in RESTS] + [("parallel", "lstm"), ("parallel", "operators")]
cases = pytest.mark.parametrize(("way", "name"), CASES)


@pytest.mark.slow
@cases
def test_the_file_passes_the_gate(way: Way, name: str, tmp_path: Path) -> None:
    """Reference, onnxruntime and CasADi agree, Jacobians included; a network's weights keep their names."""
    report = export_onnx(connected(way, name), tmp_path / "model.onnx")
    assert max(report.runtime_deg, report.casadi_deg) < 1e-4
    assert report.jacobian_points - report.kinks > 20


@cases
def test_a_series_is_one_after_the_other_and_a_parallel_connection_a_sum(way: Way, name: str) -> None:
    """Free runs from rest at the lowest command."""
    model, operators = model_of(way, name), ChainModel(simulator(WAYS[way]), "conditioned")
    alone = OnnxModel(model_bytes(rest(name)), name, "conditioned")
    commands = np.clip(np.cumsum(np.random.default_rng(3).normal(0.05, 0.4, 120)), 0.0, 6.0)
    commands[:40] = 0.0
    whole = free_run(model, commands, 45.0)
    if way == "series":
        travel = free_run(operators, commands, float(commands[0]))
        np.testing.assert_allclose(travel[0], commands[0], atol=1e-9)
        wanted = free_run(alone, travel, 45.0)
    else:
        wanted = free_run(operators, commands, 45.0) + free_run(alone, commands, 0.0)
    np.testing.assert_allclose(whole, wanted, atol=1e-3)  # the warm-up is that of both together


@cases
def test_the_rest_is_the_model_that_was_connected(way: Way, name: str) -> None:
    found, wanted = rest_of(model_of(way, name)), OnnxModel(model_bytes(rest(name)), name, "conditioned")
    assert found.metadata.connections == wanted.metadata.connections
    assert sorted(found.initializers) == sorted(wanted.initializers)
    assert found.dtype == wanted.dtype
    random = np.random.default_rng(5)
    states, u = random.normal(0, 0.3, (8, wanted.state_size)), random.uniform(0, 6, (8, 1))
    for mine, theirs in zip(found.advance(states, u), wanted.advance(states, u), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@cases
def test_the_predictor_is_the_file(way: Way, name: str) -> None:
    """Every part has its own route; together they roll out what the file steps, and the Jacobian is its derivative."""
    model = model_of(way, name)
    predictor = predictor_for(model)
    assert isinstance(predictor, SeriesPredictor if way == "series" else ParallelPredictor)
    state = predictor.initial(45.0, 2.0)
    plan = 2.0 + np.cumsum(np.random.default_rng(7).normal(0, 0.3, 15))
    x, y, angles, stepped = state[None], state, [], []
    for u in plan.tolist():
        theta, x = model.advance(x, np.array([[u]]))
        angle, y = predictor.advance(y, u)
        angles.append(float(theta[0, 0]))
        stepped.append(angle)
    np.testing.assert_allclose(stepped, angles, atol=1e-4)
    np.testing.assert_allclose(predictor.rollout(state, np.stack([plan, plan[::-1]]))[0], angles, atol=1e-4)
    along, jacobian = predictor.linearise(state, plan)
    np.testing.assert_allclose(along, angles, atol=1e-4)
    assert np.all(jacobian[np.triu_indices(plan.size, 1)] == 0)
    step, reference = connected(way, name).reference, np.zeros((plan.size, plan.size))
    x, tangent = state, np.zeros((state.size, plan.size))
    for k, u in enumerate(plan.tolist()):
        own = step.jacobian(x, u)
        moved = own[:, :-1] @ tangent
        moved[:, k] += own[:, -1]
        reference[k], tangent = moved[0], moved[1:]
        x = step.advance(x[None], np.array([[u]]))[1][0]
    np.testing.assert_allclose(jacobian, reference, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("core", [BACKLASH, RATE_PI], ids=["backlash", "pi"])
def test_a_drive_before_operators_is_their_chain(core: Operator) -> None:
    chain = predictor_for(ChainModel(simulator(Chain(core, before=DRIVE)), "conditioned"))
    alone = simulator(Chain(core))
    predictor, inverse = controller_model(ChainModel(alone, "conditioned")).behind(DRIVE, alone.metadata()).predictive
    plan = 2.0 + np.cumsum(np.random.default_rng(5).normal(0, 0.3, 15))
    states = []
    for each in (chain, predictor):
        state = each.initial(40.0, 0.0)
        for _ in range(200):
            _, state = each.advance(state, 2.0)
        states.append(state)
    for theirs, mine in zip(chain.linearise(states[0], plan), predictor.linearise(states[1], plan), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-8)
    assert isinstance(inverse, DrivenInverse)
    assert inverse.delay_samples == 2


@pytest.mark.parametrize("name", ["operators", "parallel lstm"])
def test_the_inverse_is_the_command_at_which_it_comes_to_rest(name: str) -> None:
    """Behind its drive a model has an inverse as without one."""
    known = controller_model(model_of("series", name))
    predictor, inverse = known.feedforward
    assert isinstance(inverse, DrivenInverse)
    state, u = predictor.initial(45.0, 2.0), 2.0
    for wanted in (46.0, 52.0, 49.0):
        for _ in range(80):
            u = inverse.command(state, wanted, u)
            theta, state = predictor.advance(state, u)
        # the creep goes on meanwhile, and is corrected as late as the drive is
        assert theta == pytest.approx(wanted, abs=0.1 if "lstm" in name else 1e-6)


def test_operators_that_do_not_belong_to_the_graph_are_refused() -> None:
    bundle = connected("series", "lstm")
    long = simulator(Chain(Lag(0.1), before=(Delay(1.0, 25),))).chain
    for facts_, words in (
        (with_chain(bundle, long), "expected less than"),
        (with_chain(rest("lstm"), Chain(Lag(0.1))), "is not in the graph"),
    ):
        model = OnnxModel(model_bytes(facts_), "edited", "conditioned")
        with pytest.raises(ModelError, match=words):
            predictor_for(model)


def with_chain(bundle: ExportBundle, chain: Chain) -> ExportBundle:
    """The bundle, its facts naming other operators than its graph has."""
    connection = Connection(way="series", chain=chain_spec(chain))
    return replace(bundle, metadata=bundle.metadata.model_copy(update={"connections": (connection,)}))


@pytest.mark.parametrize("lag_s", [-0.1, math.nan, math.inf])
def test_an_impossible_lag_is_refused(lag_s: float) -> None:
    with pytest.raises(ModelError, match="tau_s"):
        Drive((Lag(lag_s),), simulator(Chain(BACKLASH)).metadata())
