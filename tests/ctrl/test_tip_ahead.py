"""What a planner looks ahead with: uncertainty along a plan, forks, and the end at which a target is cut."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.core.library import engine
from hystmpc.ctrl import TipController
from hystmpc.models.load import load_simulator, model_path
from hystmpc.models.simulator import Identification, Residual

from .plays import DT, PLAY
from .test_tip_controller import controller_for, plant_for, run

SENSOR = {"sensor_sigma_deg": 0.2, "drift_sigma_deg_per_sqrt_s": 0.3, "motion_sigma_deg_per_sqrt_unit": 0.5}


def started(**options: Any) -> TipController:
    tip, plant = controller_for(**options), plant_for()
    y = plant.reset()
    tip.reset(y)
    tip.set_target(50.0)
    run(tip, plant, y, 20)
    return tip


@settings(max_examples=20, deadline=None)
@given(moves=st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=12), delay=st.sampled_from([0, 2]))
def test_the_foretold_uncertainty_is_what_the_estimator_then_has(moves: list[float], delay: int) -> None:
    """Samples without a measurement: the estimator's own variance grows as was foretold."""
    for given_ in ({}, SENSOR):
        tip = started(adaptation=None, estimator={"delay_samples": delay, **given_})
        commands = np.clip(tip.state().command + np.cumsum(moves), 0.0, 6.0)
        foretold = tip.predict_sigma_deg(commands)
        control, controller = tip.snapshot().control, tip._controller
        assert control is not None
        found = []
        for u in commands.tolist():
            control = replace(control, memory=control.memory.copy())
            known = controller.problem.address, control.memory, math.nan, u, controller._room
            assert engine().controller_look_on(*known) == 0
            found.append(controller.sigma_deg(control))
        np.testing.assert_allclose(foretold, found, rtol=1e-9)


def test_the_law_of_the_noise_is_that_of_the_model_file() -> None:
    tip = started(adaptation=None, estimator=SENSOR)
    commands = tip.state().command + 0.1 * np.arange(1, 9)
    grown = tip.predict_sigma_deg(commands) ** 2 - tip.state().sigma_deg ** 2
    np.testing.assert_allclose(grown, np.arange(1, 9) * (0.3**2 * DT + 0.5**2 * 0.1), rtol=1e-9)
    held = tip.predict_sigma_deg(np.full((2, 8), tip.state().command))
    assert held.shape == (2, 8)
    assert np.all(held[0] < tip.predict_sigma_deg(commands))


@pytest.mark.parametrize("adaptation", [None, {}])
def test_a_plan_says_how_uncertain_each_of_its_angles_is(adaptation: Any) -> None:
    tip = started(adaptation=adaptation)
    plan = tip.plan()
    assert plan.sigma_deg.shape == plan.predicted_deg.shape
    assert plan.sigma_deg[0] == tip.state().sigma_deg
    assert np.all(np.diff(plan.sigma_deg) > 0)
    assert controller_for().plan().sigma_deg.size == 0


def test_without_a_sensor_it_is_how_far_the_model_usually_is_off() -> None:
    blind = {"kind": "linearised_mpc", "estimator": {"sensor": "none"}}
    for name, known in (("pi", 0.22), ("backlash", 1.17), ("auto", 0.16), ("tendon-catheter", math.nan)):
        tip = TipController.from_config({"model": f"builtin:{name}", "controller": blind})
        tip.reset(40.0, 1.0)
        assert tip.state().sigma_deg == pytest.approx(known, abs=0.05, nan_ok=True)
        np.testing.assert_allclose(tip.predict_sigma_deg([1.0, 1.0]), tip.state().sigma_deg)


@settings(max_examples=20, deadline=None)
@given(slow=st.floats(0.05, 2.0), white=st.floats(0.0, 2.0), bias=st.floats(-1.0, 1.0))
def test_the_table_of_residuals_tells_the_slow_error_from_the_sensor(slow: float, white: float, bias: float) -> None:
    """An offset is an error too: nothing takes it off without a sensor."""
    power = slow**2 + white**2
    row = Residual(
        log="a",
        motion="holds",
        samples=100,
        rmse_deg=math.sqrt(power + bias**2),
        bias_deg=bias,
        lag_one=slow**2 / power,
    )
    assert Identification(method="m", residuals=(row, row)).slow_error == pytest.approx(math.hypot(slow, bias))
    assert Identification(method="m").slow_error is None
    own = load_simulator(model_path("builtin:pi"))
    assert own.metadata().model_sigma_deg == own.identification.slow_error


@pytest.mark.parametrize("solver", ["active_set", "osqp"])
def test_forks_and_the_original_do_not_see_each_other(solver: str) -> None:
    """Stepped at the same time by two threads, each answers to the bit what it answers alone."""
    angles = 30.0 + 8.0 * np.sin(0.2 * np.arange(60))

    def steps(tip: TipController, target: float) -> list[float]:
        tip.set_target(target)
        return [tip.step(float(y)).u for y in angles]

    first = started(solver=solver)
    alone = steps(first.fork(), 60.0), steps(first.fork(), 35.0)
    before, fork = first.snapshot(), first.fork()
    assert fork.snapshot() is before
    found: dict[str, list[float]] = {}
    threads = [
        threading.Thread(target=lambda: found.__setitem__("fork", steps(fork, 60.0))),
        threading.Thread(target=lambda: found.__setitem__("own", steps(first, 35.0))),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (found["fork"], found["own"]) == alone
    fork.stop()
    assert (fork.state().stopped, first.state().stopped) == (True, False)


@settings(max_examples=50, deadline=None)
@given(target=st.floats(-1e3, 1e3))
def test_a_target_out_of_reach_says_where_it_is_cut(target: float) -> None:
    tip = controller_for()
    tip.reset(PLAY.y_rest)
    reach = tip.set_target(target)
    assert reach.nearest_deg == min(max(target, reach.low_deg), reach.high_deg)
    assert reach.reachable is (reach.nearest_deg == target)
    assert reach.reachable or f"{reach.nearest_deg:.6g} deg, at which it is cut" in reach.reason
    assert tip.reachable(target) == reach
    assert math.isnan(tip.reachable(math.nan).nearest_deg)
