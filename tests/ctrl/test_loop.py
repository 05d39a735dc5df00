"""The loop: aligned logs, a plant that is always stopped, interrupts that keep what there is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.loop import run_loop
from hystmpc.trials.errors import ControllerError

from .plays import DT, PLAY, ModelPlant

CASE = PLAY


@pytest.fixture
def controller() -> GuardedController:
    settings = CONTROLLERS["linearised_mpc"].parse({"horizon": 5})
    return build_controller(settings, CASE.predictor, CASE.inverse, CommandLimits(0.0, 6.0, 12.0))


@pytest.fixture
def plant() -> ModelPlant:
    return ModelPlant(CASE.predictor, CASE.y_rest, CASE.u_rest)


def ramp(k: int) -> np.ndarray:
    return 30.0 + 0.5 * (k + np.arange(5))


def test_rows_of_the_log_belong_to_the_same_instant(controller: GuardedController, plant: ModelPlant) -> None:
    seen: list[float] = []
    log = run_loop(controller, plant, ramp, 40, on_sample=lambda sample: seen.append(sample.measured_deg))
    np.testing.assert_allclose(log.time_s, DT * np.arange(1, 41))
    np.testing.assert_allclose(log.reference_deg, 30.0 + 0.5 * np.arange(40))
    np.testing.assert_array_equal(log.measured_deg, plant.true[1:])
    np.testing.assert_array_equal(log.measured_deg, seen)
    np.testing.assert_allclose(log.predicted_deg, log.measured_deg, atol=1e-9)  # the model is exact
    np.testing.assert_allclose(log.measured_deg[5:], log.reference_deg[5:], atol=0.1)
    assert log.step_s.shape == (40,)
    assert set(log.stage_s) == {"step"}
    assert plant.stopped
    assert not log.interrupted


def test_keyboard_interrupt_stops_the_plant_and_keeps_the_log(controller: GuardedController, plant: ModelPlant) -> None:
    def interrupt(sample: Any) -> None:
        if sample.time_s > 10.5 * DT:
            raise KeyboardInterrupt

    log = run_loop(controller, plant, ramp, 40, on_sample=interrupt)
    assert log.interrupted
    assert log.time_s.size == 11
    assert plant.stopped


def test_plant_is_stopped_when_it_fails(controller: GuardedController, plant: ModelPlant) -> None:
    def fail(u: float) -> float:
        raise OSError("the drive is gone")

    plant.apply = fail  # type: ignore[method-assign]
    with pytest.raises(OSError, match="the drive is gone"):
        run_loop(controller, plant, ramp, 40)
    assert plant.stopped


def test_other_sample_time_is_refused(controller: GuardedController, plant: ModelPlant) -> None:
    plant.dt = 0.02
    with pytest.raises(ControllerError, match=r"controller at 0\.04 s and a plant at 0\.02 s"):
        run_loop(controller, plant, ramp, 1)


def test_no_steps_give_an_empty_log(controller: GuardedController, plant: ModelPlant) -> None:
    log = run_loop(controller, plant, ramp, 0)
    assert log.time_s.size == log.step_s.size == len(log.source) == 0
