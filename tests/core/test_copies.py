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
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.stages import prepared

from ..ctrl.plays import compiled_pi
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
def test_a_controller_steps_as_its_original(copied: Callable[[Any], Any]) -> None:
    predictor, inverse = compiled_pi()
    controller = build_controller(LinearisedMpcSettings(), predictor, inverse, CommandLimits(0.0, 6.0, 12.0))
    state, wanted = controller.init(22.0, 0.0), np.full(controller.horizon, 40.0)
    expected, after = controller.step(state, 22.0, wanted)
    made, then = copied((controller, state))
    assert made.problem.address != controller.problem.address
    del controller, state, predictor, inverse
    gc.collect()
    command, following = made.step(then, 22.0, wanted)
    np.testing.assert_array_equal(command.plan, expected.plan)
    np.testing.assert_array_equal(following.memory, after.memory)
