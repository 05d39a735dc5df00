"""What holds addresses of the engine's memory is built anew where it is copied: a copy outlives its original."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.ctrl.law_tables import LawTables
from hystmpc.ctrl.mpc import PlanningProblem
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.models.stages import prepared

from ..models.lstm_examples import make_route, random_weights
from ..models.zoo import DT, RATE_PI

COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda original: pickle.loads(pickle.dumps(original)),
}
copies = pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
PLAN = 1.0 + np.sin(np.arange(20.0))


@copies
def test_a_function_is_found_by_its_name(copied: Callable[[Any], Any]) -> None:
    assert copied(engine().first_acting) is engine().first_acting
    plain = copied(engine("plain").first_acting)
    assert plain is engine("plain").first_acting


@copies
def test_a_chain_predicts_as_its_original(copied: Callable[[Any], Any]) -> None:
    chain = prepared([RATE_PI], DT)
    state, expected = np.zeros(chain.code.states), chain.roll_out(np.zeros(chain.code.states), PLAN[None])
    made = copied(chain)
    del chain
    gc.collect()
    np.testing.assert_array_equal(made.roll_out(state, PLAN[None]), expected)


@copies
def test_a_network_has_weights_of_its_own(copied: Callable[[Any], Any]) -> None:
    route = make_route(random_weights(7, 2), "plain")
    state = np.zeros(28)
    expected, address = route.rollout(state, PLAN[None]), route.address
    made = copied(route)
    assert made.address != address
    route.packed[:] = 0
    del route
    gc.collect()
    np.testing.assert_array_equal(made.rollout(state, PLAN[None]), expected)


@copies
def test_a_law_and_a_problem_have_memory_of_their_own(copied: Callable[[Any], Any]) -> None:
    tables = LawTables(WeightsSettings(), 20)
    problem = PlanningProblem(np.zeros(3), 1.0, PLAN, PLAN, (0.0, 90.0))
    values, again = np.empty(1), np.empty(1)
    engine().costs(tables.address, problem.task, 1, PLAN[None].copy(), 2 * PLAN[None], values)
    law, task = copied(tables), copied(problem)
    assert law.address != tables.address
    assert task.task != problem.task
    del tables, problem
    gc.collect()
    engine().costs(law.address, task.task, 1, PLAN[None].copy(), 2 * PLAN[None], again)
    np.testing.assert_array_equal(again, values)
