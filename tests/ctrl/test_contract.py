"""Contract of every controller over every model, sound and broken: a step never raises and never leaves the limits."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits, Source
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.trials.errors import ControllerError

from .plays import BROKEN, DRIVEN, PLAY, SOUND, Case

LIMITS = [CommandLimits(0.0, 6.0, 12.0), CommandLimits(-1.0, 2.5, 0.7), CommandLimits(0.0, 0.01, 500.0)]
CASES = {case.name: case for case in [*SOUND, DRIVEN, *BROKEN]}
VARIANTS: dict[str, dict[str, Any]] = {
    "linearised_mpc, OSQP": {"kind": "linearised_mpc", "solver": "osqp"},
    "linearised_mpc, blocked": {"kind": "linearised_mpc", "move_blocking": [1, 2, 2]},
    "sampling_mpc, CEM": {"kind": "sampling_mpc", "method": "cem"},
}
KINDS = [*CONTROLLERS, *VARIANTS]
QUICK: dict[str, dict[str, Any]] = {
    "linearised_mpc": {"horizon": 6, "weights": {"angle_upper_deg": 60.0}},
    "sampling_mpc": {"horizon": 6, "samples": 16, "noise": {"kind": "coloured"}},
}


@cache
def controller_for(kind: str, name: str, limits: CommandLimits, delay: int = 0) -> GuardedController:
    case, variant = CASES[name], VARIANTS.get(kind, {"kind": kind})
    options = {**QUICK.get(variant["kind"], {}), **variant}
    if kind != "pid":
        options["estimator"] = {"delay_samples": delay}
    options["ladder"] = {"stop_after_failures": 5, "max_missing_samples": 3, "safe_command": limits.lower}
    return build_controller(CONTROLLERS[variant["kind"]].parse(options), case.predictor, case.inverse, limits)


any_float = st.floats(allow_nan=True, allow_infinity=True)
measurements = st.one_of(st.floats(20.0, 90.0), any_float, st.none(), st.just("?"))
references = st.one_of(
    st.floats(20.0, 90.0).map(lambda level: np.full(30, level)),
    st.lists(any_float, max_size=30).map(np.array),
    st.floats(-1e4, 1e4).map(lambda slope: 30.0 + slope * np.arange(30)),
    st.none(),
    any_float,
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if k % 2 else ()) for k, name in enumerate(CASES)]
)
@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_never_raises_and_never_leaves_the_limits(kind: str, name: str, data: st.DataObject) -> None:
    limits = data.draw(st.sampled_from(LIMITS))
    controller = controller_for(kind, name, limits, data.draw(st.sampled_from([0, 2])))
    u = min(max(CASES[name].u_rest, limits.lower), limits.upper)
    state = controller.init(CASES[name].y_rest, u)
    for y, reference in data.draw(st.lists(st.tuples(measurements, references), min_size=1, max_size=12)):
        command, state = controller.step(state, y, reference)
        assert math.isfinite(command.u)
        assert limits.lower <= command.u <= limits.upper
        assert abs(command.u - u) <= limits.rate * controller.dt * (1 + 1e-12)
        assert command.status
        assert "\n" not in command.status
        assert command.timing.total_s > 0
        u = command.u


@pytest.mark.parametrize("case", [*SOUND, DRIVEN], ids=lambda c: c.name)
@pytest.mark.parametrize("kind", KINDS)
def test_restored_snapshot_gives_the_same_command(kind: str, case: Case) -> None:
    controller = controller_for(kind, case.name, LIMITS[0])
    state, stored, sent = controller.init(case.y_rest, case.u_rest), [], []
    random = np.random.default_rng(3)
    steps = [(case.y_rest + k + random.normal(), case.y_rest + k + np.arange(30.0)) for k in range(12)]
    for y, reference in steps:
        stored.append(state)
        command, state = controller.step(state, y, reference)
        sent.append(command.u)
    for k in (9, 2, 5):  # out of order: nothing may hide in the controller
        command, _ = controller.step(stored[k], *steps[k])
        assert command.u == sent[k]


@pytest.mark.parametrize("kind", KINDS)
def test_plan_and_prediction_belong_to_the_command(kind: str) -> None:
    case = PLAY
    controller = controller_for(kind, case.name, LIMITS[0], 2)
    state = controller.init(case.y_rest, case.u_rest)
    command, after = controller.step(state, case.y_rest, np.full(30, 45.0))
    assert command.source in (Source.CONTROLLER, Source.MPC)
    assert after.estimate.command == command.u
    if command.plan.size:
        assert command.plan[0] == pytest.approx(command.u, abs=1e-12)
        assert command.plan.size == command.predicted.size == controller.horizon - 2
    assert command.predicted.size == 0 or command.predicted[0] == pytest.approx(case.y_rest)  # under way: two rests


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("y", "u"), [(math.nan, 0.0), (30.0, 6.5), (30.0, math.nan)])
def test_start_that_makes_no_sense_is_refused(kind: str, y: float, u: float) -> None:
    with pytest.raises(ControllerError, match="expected a finite angle"):
        controller_for(kind, PLAY.name, LIMITS[0]).init(y, u)


@pytest.mark.parametrize("kind", KINDS)
def test_a_memory_that_is_cut_off_or_of_another_controller_is_refused(kind: str) -> None:
    controller, other = (controller_for(kind, PLAY.name, LIMITS[0], delay) for delay in (0, 2))
    state = controller.init(PLAY.y_rest, PLAY.u_rest)
    wrong = [replace(state, memory=state.memory[:-8].copy()), replace(state, memory=state.memory[:0].copy())]
    if kind != "pid":  # whose memory has no angles on their way
        wrong.append(other.init(PLAY.y_rest, PLAY.u_rest))
    for bad in wrong:
        with pytest.raises(ControllerError, match="cut off, or of another controller"):
            controller.step(bad, PLAY.y_rest, np.full(30, 45.0))
        with pytest.raises(ControllerError, match="cut off, or of another controller"):
            controller.stop(bad, "by a test")
