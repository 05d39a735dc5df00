"""What a planner cannot undo by accident: a latched stop, and limits from the command really sent."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl import Command, Source, TipController
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.trials.errors import ControllerError

from .plays import DT, LINEAR, PLAY
from .test_tip_controller import LIMITS, controller_for, plant_for, run

STEP = LIMITS.rate * DT * (1 + 1e-12)


def moved(kind: str = "linearised_mpc", **options: Any) -> tuple[TipController, float]:
    """A controller in the middle of a motion, and the angle measured last."""
    tip, plant = controller_for(kind=kind, **options), plant_for()
    tip.set_target(60.0)
    return tip, run(tip, plant, plant.reset(), 30)


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_restoring_keeps_a_latched_stop(kind: str) -> None:
    tip, y = moved(kind)
    before = tip.snapshot()
    tip.stop()
    stopped = tip.step(y)
    tip.restore(before)
    assert tip.state().stopped
    after = tip.step(y)
    assert (after.source, after.u) == (Source.STOP, stopped.u)
    assert after.status == "stopped: latched by stop()"
    with pytest.raises(ControllerError, match="expected reset"):
        tip.set_target(50.0)
    tip.reset(y)  # the one release
    tip.restore(before)
    assert not tip.state().stopped
    assert tip.step(y).source is not Source.STOP


def test_restoring_keeps_a_stop_after_failures_with_its_cause() -> None:
    tip, y = moved(ladder={"stop_after_failures": 2, "max_missing_samples": 1})
    before = tip.snapshot()
    while not tip.state().stopped:
        tip.step(math.nan)
    tip.restore(before)
    assert tip.step(y).status == "stopped: latched after repeated failures"


def test_replaying_keeps_a_latched_stop() -> None:
    tip, y = moved()
    u = tip.state().command
    tip.stop()
    tip.replay([u, u], [y, y])
    assert tip.state().stopped
    assert tip.step(y).source is Source.STOP


def test_a_snapshot_of_a_stopped_controller_is_stopped() -> None:
    tip, y = moved()
    tip.stop()
    stopped = tip.snapshot()
    tip.reset(y)
    tip.restore(stopped)
    assert tip.step(y).source is Source.STOP


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_after_a_restore_the_command_goes_on_from_the_one_really_sent(kind: str) -> None:
    tip, y = moved(kind)
    high = tip.snapshot()
    assert high.command.u > 2 * STEP
    tip.reset(PLAY.y_rest, command=0.0)
    tip.set_target(35.0)
    sent = tip.step(PLAY.y_rest).u
    tip.restore(high)
    assert tip.state().command == sent
    assert abs(tip.step(y).u - sent) <= STEP


def test_a_branch_says_what_the_rewound_device_holds() -> None:
    tip, y = moved()
    stored, future = tip.snapshot(), [y + 0.3 * k for k in range(6)]
    first = [tip.step(angle).u for angle in future]
    tip.restore(stored, held=stored.command.u)
    assert tip.state().command == stored.command.u
    assert [tip.step(angle).u for angle in future] == first


@pytest.mark.parametrize("snapshot", [None, 3, "snapshot", {"command": 1.0}])
def test_what_is_no_snapshot_is_refused_and_changes_nothing(snapshot: Any) -> None:
    tip, y = moved()
    before = tip.snapshot()
    with pytest.raises(ControllerError, match=f"restore: got {type(snapshot).__name__}, expected what snapshot"):
        tip.restore(snapshot)
    assert tip.snapshot() is before
    assert tip.step(y).source is Source.MPC


def test_a_snapshot_of_another_controller_is_refused() -> None:
    tip, y = moved()
    others = [
        moved("pid")[0],
        moved(weights={"rate": 4.0})[0],
        controller_for(LINEAR),
    ]
    for other in others:
        with pytest.raises(
            ControllerError, match=r"restore: got a snapshot of '.*', expected one of 'linearised_mpc"
        ) as e:
            tip.restore(other.snapshot())
        assert "\n" not in str(e.value)
    twin = controller_for()
    twin.restore(tip.snapshot())
    assert twin.step(y).u <= STEP  # it has sent nothing yet: its device holds the start command


@pytest.mark.parametrize("u", [math.nan, math.inf, -0.1, 6.1])
def test_a_snapshot_with_a_command_beyond_the_limits_is_refused(u: float) -> None:
    tip, _ = moved()
    stored = tip.snapshot()
    with pytest.raises(ControllerError, match=r"restore: got a snapshot with command .*, expected 0\.0 to 6\.0"):
        tip.restore(replace(stored, command=Command(u, Source.MPC)))


@pytest.mark.parametrize("held", [math.nan, math.inf, -1.0, 7.0, "two"])
def test_a_held_command_beyond_the_limits_is_refused(held: Any) -> None:
    tip, y = moved()
    stored = tip.snapshot()
    for call in (
        lambda: tip.restore(stored, held=held),
        lambda: tip.replay([1.0], [y], held=held),
        lambda: tip.reset(y, command=held),
    ):
        with pytest.raises(ControllerError, match=r"got (held|command) .*, expected 0\.0 to 6\.0"):
            call()
    assert tip.snapshot() is stored


def test_a_recording_that_contradicts_what_was_sent_is_refused() -> None:
    tip, y = moved()
    sent = tip.state().command
    with pytest.raises(ControllerError, match=r"replay: got a recording that ends at command 0\.04, expected .*held="):
        tip.replay([0.0, 0.04], [PLAY.y_rest] * 2)
    tip.replay([0.0, 0.04], [PLAY.y_rest] * 2, held=sent)
    assert tip.state().command == sent
    assert abs(tip.step(y).u - sent) <= STEP
    tip.replay([0.0, 0.04], [PLAY.y_rest] * 2, held=0.04)
    assert abs(tip.step(y).u - 0.04) <= STEP


def test_a_reset_goes_on_from_the_command_sent_last() -> None:
    tip, y = moved()
    sent = tip.state().command
    tip.stop()
    tip.reset()
    assert not tip.state().stopped
    tip.set_target(PLAY.y_rest)
    assert abs(tip.step(y).u - sent) <= STEP


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_samples_taken_elsewhere_are_gone_on_from(kind: str) -> None:
    tip, y = moved(kind)
    before, u = tip.state(), tip.state().command
    for sign in (1.0, -1.0):
        for _ in range(4):
            u = min(max(u + sign * STEP, LIMITS.lower), LIMITS.upper)
            tip.took(1, Command(u, Source.MPC))
        assert tip.state().command == u
        last, u = u, tip.step(y).u
        assert abs(u - last) <= STEP
    assert tip.state().time_s == pytest.approx(before.time_s + 10 * DT)


calls = st.one_of(
    st.tuples(st.just("target"), st.floats(20.0, 90.0)),
    *2 * [st.tuples(st.just("step"), st.one_of(st.just(math.nan), st.floats(20.0, 90.0)))],
    st.tuples(st.just("skip"), st.integers(1, 5)),
    st.tuples(st.just("took"), st.floats(-1.0, 1.0)),
    st.tuples(st.just("measure"), st.tuples(st.floats(20.0, 90.0), st.floats(0.0, 5.0))),
    st.tuples(st.just("stop"), st.none()),
    st.tuples(st.just("reset"), st.one_of(st.none(), st.floats(25.0, 35.0))),
    st.tuples(st.just("keep"), st.none()),
    st.tuples(st.just("restore"), st.integers(0, 9)),
    st.tuples(st.just("replay"), st.lists(st.floats(0.0, 6.0), min_size=1, max_size=4)),
)


KINDS: list[tuple[str, dict[str, Any]]] = [
    *((kind, {"samples": 32} if kind == "sampling_mpc" else {}) for kind in CONTROLLERS),
    ("linearised_mpc", {"estimator": {"sensor": "intermittent"}}),
    ("pid", {"estimator": {"sensor": "intermittent"}}),
    ("linearised_mpc", {"estimator": {"delay_samples": 2}}),
]


@pytest.mark.parametrize(("kind", "options"), KINDS, ids=lambda value: value if isinstance(value, str) else "")
@pytest.mark.parametrize("safe", [None, 0.0, 4.0])
@settings(max_examples=12, deadline=None)
@given(todo=st.lists(calls, min_size=5, max_size=40))
def test_no_order_of_calls_jumps_or_releases_a_stop(  # noqa: C901 - a branch a call
    kind: str, options: dict[str, Any], safe: float | None, todo: list[tuple[str, Any]]
) -> None:
    """The command moves by at most one step's worth from the one sent last; a stop ends with a reset and not before."""
    ladder = {"safe_command": safe, "stop_after_failures": 4, "max_missing_samples": 2}
    tip, u, latched = controller_for(kind=kind, ladder=ladder, **options), 0.0, False
    kept = [tip.snapshot()]
    for name, value in todo:
        if name == "step":
            command = tip.step(value)
            assert abs(command.u - u) <= STEP
            assert LIMITS.lower <= command.u <= LIMITS.upper
            assert not latched or command.source in (Source.STOP, Source.HOLD)
            u, latched = command.u, tip.state().stopped
        elif name == "skip":  # the device holds what it was sent, however long
            for _ in range(value):
                assert tip.skip().u == u
        elif name == "took":  # a step that was taken elsewhere, in the place of this one
            u = min(max(u + value * STEP, LIMITS.lower), LIMITS.upper)
            tip.took(1, Command(u, Source.MPC))
        elif name == "measure":
            with suppress(ControllerError):  # a sensor that has no frames, or none so old
                tip.measure(value[0], tip.state().time_s - value[1] * DT)
        elif name == "stop":
            tip.stop()
            latched = True
        elif name == "reset":
            with suppress(ControllerError):  # an angle that the model does not have at this command
                tip.reset(value)
                latched = False
        elif name == "keep":
            kept.append(tip.snapshot())
        elif name == "restore":
            tip.restore(kept[value % len(kept)])
            latched = latched or tip.state().stopped
        elif name == "replay":
            with suppress(ControllerError):
                tip.replay(value, [PLAY.y_rest] * len(value), held=u)
        elif not tip.state().stopped:
            tip.set_target(value)
        assert tip.state().command == u
        assert tip.state().stopped or not latched


@pytest.mark.parametrize("kind", CONTROLLERS)
@settings(max_examples=10, deadline=None)
@given(steps=st.integers(1, 60), target=st.floats(35.0, 80.0), safe=st.sampled_from([None, 0.0, 1.0, 4.0]))
def test_a_stop_never_moves_the_command_further_from_the_safe_one(
    kind: str, steps: int, target: float, safe: float | None
) -> None:
    """The controller's own stop brakes at once: straight to the safe command, at most at the rate limit."""
    options = {"samples": 32} if kind == "sampling_mpc" else {}
    tip, plant = controller_for(kind=kind, ladder={"safe_command": safe}, **options), plant_for()
    tip.set_target(target)
    y = run(tip, plant, plant.reset(), steps)
    tip.stop()
    last = tip.state().command
    goal = last if safe is None else safe
    for _ in range(20):
        command = tip.step(y)
        assert abs(command.u - goal) <= abs(last - goal)
        assert abs(command.u - last) <= STEP
        y, last = plant.apply(command.u), command.u
    assert last == goal
