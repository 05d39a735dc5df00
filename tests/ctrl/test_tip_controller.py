"""The planner's API: targets at any time, steps that never raise, snapshots that restore the future."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl import CommandLimits, Source, TipController
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.planner.reach import Workspace, angles_at_rest
from hystmpc.ctrl.planner.settings import Assembly, TipSettings
from hystmpc.trials.errors import ControllerError

from .plays import DT, PLAY, SOUND, Case, ModelPlant

LIMITS = CommandLimits(0.0, 6.0, 12.0)
MOTION = {"velocity_deg_s": 30.0, "acceleration_deg_s2": 200.0, "jerk_deg_s3": 3000.0}


def controller_for(case: Case = PLAY, kind: str = "linearised_mpc", **options: Any) -> TipController:
    """A controller on one of the tests' own models."""
    tip = TipSettings.parse({"model": "unused", "motion": MOTION, "controller": {"kind": kind, **options}})
    control = build_controller(tip.controller, case.predictor, case.inverse, LIMITS)
    ends = angles_at_rest(case.predictor, LIMITS, case.y_rest)
    workspace = Workspace(ends, (-math.inf, math.inf), (30.0, 80.0))
    return TipController(Assembly(control, case.predictor, LIMITS, workspace, "mm", LIMITS), tip)


def plant_for(case: Case = PLAY, **effects: Any) -> ModelPlant:
    return ModelPlant(case.predictor, case.y_rest, case.u_rest, **effects)


def run(tip: TipController, plant: ModelPlant, y: float, steps: int) -> float:
    for _ in range(steps):
        y = plant.apply(tip.step(y).u)
    return y


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("kind", ["linearised_mpc", "inverse"])
def test_a_target_is_reached_and_said_to_be(case: Case, kind: str) -> None:
    tip, plant = controller_for(case, kind), plant_for(case)
    y = plant.reset()
    tip.reset(y)
    assert not tip.state().stopped
    assert tip.set_target(50.0)
    assert not tip.state().done
    y = run(tip, plant, y, 75)
    state = tip.state()
    assert (state.done, state.settled) == (True, True)
    assert y == pytest.approx(50.0, abs=0.1)
    assert (state.reference_deg, state.reference_velocity_deg_s) == (50.0, 0.0)
    assert state.predicted_deg == pytest.approx(y, abs=0.05)
    assert state.time_s == pytest.approx(75 * DT)


def test_retargeting_in_mid_motion_leaves_no_jump_in_what_the_controller_sees() -> None:
    tip, plant = controller_for(), plant_for()
    y, seen = plant.reset(), []
    for k in range(90):
        if k in (2, 20, 29):
            tip.set_target({2: 60.0, 20: 35.0, 29: 45.0}[k])
        y = plant.apply(tip.step(y).u)
        seen.append(tip.state().reference_deg)
    speed = np.diff(seen) / DT
    assert np.max(np.abs(speed)) <= 30.0 * (1 + 1e-9)
    assert np.max(np.abs(np.diff(speed))) <= 200.0 * DT * (1 + 1e-9)
    assert seen[-1] == 45.0


def test_targets_set_before_the_start_wait_for_the_first_measurement() -> None:
    tip = controller_for()
    tip.set_target(40.0)
    waiting = tip.step(math.nan)
    assert (waiting.source, waiting.u) == (Source.HOLD, 0.0)
    assert waiting.status.startswith("not started: no usable measurement yet")
    assert math.isnan(tip.state().reference_deg)
    assert tip.step(PLAY.y_rest).source is Source.MPC
    assert PLAY.y_rest < tip.state().reference_deg < 40.0
    refused = controller_for()
    assert "the model expects" in refused.step(500.0).status  # too far off the model; a reset says it aloud
    with pytest.raises(ControllerError, match="the model expects"):
        refused.reset(500.0)


def test_a_skipped_sample_is_a_hold_in_the_middle_of_a_motion_too() -> None:
    """The device has got nothing: whatever is planned, the command before it is the one that it holds."""
    tip, plant = controller_for(), plant_for()
    y = plant.reset()
    tip.reset(y)
    tip.set_target(60.0)
    y = run(tip, plant, y, 5)
    held = tip.state().command
    skipped = tip.skip()
    assert (skipped.u, skipped.source, skipped.status) == (held, Source.HOLD, "reference: sample skipped, command held")
    assert tip.state().time_s == pytest.approx(6 * DT)
    assert tip.step(plant.apply(held)).u > held


@pytest.mark.parametrize("kind", CONTROLLERS)
@pytest.mark.parametrize("safe", [None, 0.0, 5.0])
def test_a_skipped_sample_is_a_hold_in_a_latched_stop_too(kind: str, safe: float | None) -> None:
    """The ramp to the safe command goes on from what the device holds, however many samples were skipped."""
    tip, plant = controller_for(kind=kind, ladder={"safe_command": safe}), plant_for()
    tip.set_target(60.0)
    y = run(tip, plant, plant.reset(), 20)
    tip.stop()
    held = tip.step(y).u
    for _ in range(5):
        skipped = tip.skip()
        assert (skipped.u, skipped.source) == (held, Source.STOP)
        assert skipped.status == "stopped: latched by stop(); sample skipped, command held"
    assert tip.state().time_s == pytest.approx(26 * DT)
    assert abs(tip.step(y).u - held) <= LIMITS.rate * DT * (1 + 1e-12)
    assert tip.state().stopped


def test_a_sample_skipped_before_the_start_is_no_command() -> None:
    """So that a recording may still end at what the device really holds."""
    tip = controller_for()
    assert tip.skip().u == 0.0
    assert not tip.snapshot().sent
    tip.replay([1.0], [42.0])
    assert tip.state().command == 1.0


def test_waypoints_and_previews_are_followed_to_their_end() -> None:
    tip, plant = controller_for(), plant_for()
    y = plant.reset()
    tip.set_waypoints([40.0, 35.0], [0.4, 0.2])
    while not tip.state().done:
        y = plant.apply(tip.step(y).u)
    assert y == pytest.approx(35.0, abs=0.1)
    tip.set_reference(np.linspace(35.0, 45.0, 40))
    y = run(tip, plant, y, 50)
    assert tip.state().done
    assert y == pytest.approx(45.0, abs=0.1)
    tip.set_reference(lambda t: 45.0 + 5.0 * math.sin(t))
    y = run(tip, plant, y, 50)
    assert not tip.state().done
    assert y == pytest.approx(45.0 + 5.0 * math.sin(50 * DT), abs=0.1)


def test_a_function_that_fails_later_is_a_hold_with_its_reason() -> None:
    tip = controller_for()

    def fails(t: float) -> float:
        if t > 1.0:
            raise OSError("planner\ngone")
        return 40.0

    tip.set_reference(fails)
    sources = [tip.step(30.0).source for _ in range(12)]
    assert sources[0] is Source.MPC
    assert sources[-1] is Source.HOLD
    assert tip.state().status == "reference: OSError: planner gone"
    assert math.isnan(tip.state().reference_deg) or tip.state().reference_deg == 40.0
    tip.set_target(35.0)
    assert tip.step(30.0).source is Source.MPC


@pytest.mark.parametrize("kind", CONTROLLERS)
@pytest.mark.parametrize("safe", [None, 0.5])
def test_stop_is_latched_until_reset(kind: str, safe: float | None) -> None:
    tip, plant = controller_for(kind=kind, ladder={"safe_command": safe}), plant_for()
    tip.set_target(60.0)
    y = run(tip, plant, plant.reset(), 20)
    u = tip.state().command
    tip.stop()
    y = run(tip, plant, y, 20)
    assert tip.state().stopped
    assert tip.state().source is Source.STOP
    assert tip.state().status == "stopped: latched by stop()"
    assert tip.state().command == (u if safe is None else safe)
    for call in (lambda: tip.set_target(50.0), lambda: tip.set_reference([1.0]), lambda: tip.set_waypoints([1], [1])):
        with pytest.raises(ControllerError, match="expected reset"):
            call()
    tip.reset(y)
    assert tip.state().command == (u if safe is None else safe)
    tip.set_target(50.0)
    assert tip.step(y).source in (Source.MPC, Source.CONTROLLER)


def test_stop_before_the_start_counts() -> None:
    tip = controller_for()
    tip.stop()
    assert tip.step(PLAY.y_rest).source is Source.STOP


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_restoring_a_snapshot_restores_the_future(kind: str) -> None:
    options = {"samples": 32} if kind == "sampling_mpc" else {}
    tip, plant = controller_for(kind=kind, **options), plant_for(noise_deg=0.1)
    y = plant.reset()
    tip.set_target(60.0)
    y = run(tip, plant, y, 9)
    stored, future = tip.snapshot(), [y + 0.3 * k for k in range(12)]
    first = [tip.step(angle).u for angle in future]
    tip.set_target(31.0)
    tip.step(y)
    tip.restore(stored, held=stored.command.u)  # the device is rewound too
    assert [tip.step(angle).u for angle in future] == first


def test_prediction_is_what_then_happens() -> None:
    tip, plant = controller_for(estimator={"delay_samples": 2}), plant_for(delay_samples=2)
    y = plant.reset()
    tip.set_target(50.0)
    y = run(tip, plant, y, 25)
    commands = tip.state().command + np.cumsum(np.full(6, 0.1))
    expected = tip.predict(commands)
    assert tip.predict(np.tile(commands, (3, 1))).shape == (3, 6)
    np.testing.assert_allclose(expected, [plant.apply(u) for u in commands], atol=1e-9)


@pytest.mark.parametrize("commands", [[math.nan], [7.0], [0.0, 5.0], [], [[[0.0]]]])
def test_plans_that_could_not_be_sent_are_not_predicted(commands: Any) -> None:
    tip = controller_for()
    with pytest.raises(ControllerError, match="has not started"):
        tip.predict([0.0])
    tip.step(PLAY.y_rest)
    with pytest.raises(ControllerError, match="expected \\(N,\\) or \\(K, N\\) finite commands"):
        tip.predict(commands)
    without = controller_for(kind="pid")
    without.step(PLAY.y_rest)
    with pytest.raises(ControllerError, match="has no model"):
        without.predict([0.0])


def test_plan_begins_with_the_command_and_belongs_to_the_reference() -> None:
    tip = controller_for()
    assert np.isnan(tip.plan().reference_deg).all()
    tip.set_target(50.0)
    command = tip.step(PLAY.y_rest)
    plan = tip.plan()
    assert plan.command[0] == command.u
    assert plan.time_s[0] == tip.state().time_s
    assert plan.time_s.size == plan.command.size == plan.predicted_deg.size == plan.reference_deg.size == 20
    assert plan.reference_deg[0] == tip.state().reference_deg


def test_a_target_out_of_reach_ends_at_the_limit() -> None:
    tip, plant = controller_for(), plant_for()
    y = plant.reset()
    tip.set_target(120.0)
    y = run(tip, plant, y, 150)
    assert tip.state().command == 6.0
    assert tip.state().done
    assert not tip.state().settled
    assert tip.state().source is Source.MPC


calls = st.one_of(
    st.tuples(st.just("target"), st.floats(-200.0, 200.0)),
    st.tuples(st.just("array"), st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=5)),
    st.tuples(st.sampled_from(["stop", "reset"]), st.none()),
    st.tuples(st.just("step"), st.one_of(st.floats(), st.none(), st.floats(20.0, 90.0))),
)


@given(st.lists(calls, max_size=25))
@settings(max_examples=60, deadline=None)
def test_any_order_of_calls_keeps_the_limits(todo: list[tuple[str, Any]]) -> None:
    tip, u = controller_for(horizon=6), 0.0
    for name, value in todo:
        if name == "step":
            command = tip.step(value)
            assert LIMITS.lower <= command.u <= LIMITS.upper
            assert abs(command.u - u) <= LIMITS.rate * DT * (1 + 1e-12)
            u = command.u
        elif name == "stop":
            tip.stop()
        elif name == "reset":
            tip.reset()
        elif not tip.state().stopped:
            tip.set_target(value) if name == "target" else tip.set_reference(value)
        assert tip.state().command == u
        tip.plan()


def test_targets_may_be_set_while_another_thread_steps() -> None:
    tip, plant, failures = controller_for(horizon=6), plant_for(), []
    done = threading.Event()

    def plan() -> None:
        random = np.random.default_rng(0)
        while not done.is_set():
            try:
                tip.set_target(float(random.uniform(35.0, 75.0)))
                tip.plan()
                tip.predict([tip.state().command])
            except ControllerError as error:
                if "expected (N,)" not in str(error):  # the command may have moved since it was asked for
                    failures.append(error)

    y = run(tip, plant, plant.reset(), 1)
    planner = threading.Thread(target=plan)
    planner.start()
    sources, speeds, before = set(), [], tip.state().reference_deg
    for _ in range(300):
        command = tip.step(y)
        y = plant.apply(command.u)
        sources.add(command.source)
        speeds.append((tip.state().reference_deg - before) / DT)
        before = tip.state().reference_deg
    done.set()
    planner.join()
    assert failures == []
    assert sources == {Source.MPC}
    assert np.max(np.abs(speeds)) <= 30.0 * (1 + 1e-9)
