"""A user's reference function may take any time: nothing waits for it, and what happens meanwhile is not lost."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl import Command, Source, TipController
from hystmpc.trials.errors import ControllerError

from .plays import DT, PLAY
from .test_tip_controller import LIMITS, controller_for, plant_for, run

GUARD_S = 20.0  # of a thread that must not wait; only failing code comes near


class Gate:
    """A reference function that waits, once it is armed, until it is let through; a planner that has hung."""

    def __init__(self) -> None:
        self.armed, self.entered, self.through = False, Event(), Event()

    def __call__(self, t: float) -> float:
        if self.armed:
            self.entered.set()
            assert self.through.wait(3 * GUARD_S)
        return 40.0 + 0.0 * t


def while_it_evaluates(tip: TipController, gate: Gate, y: float, action: Callable[[], Any]) -> Command:
    """The command of a step during whose evaluation of the reference another thread has done something."""
    answers: list[Command] = []
    gate.armed = True
    stepping = Thread(target=lambda: answers.append(tip.step(y)), daemon=True)
    stepping.start()
    assert gate.entered.wait(GUARD_S)
    acting = Thread(target=action, daemon=True)
    acting.start()
    acting.join(GUARD_S)
    waited = acting.is_alive()
    gate.armed = False
    gate.through.set()
    stepping.join(GUARD_S)
    acting.join(GUARD_S)
    assert not waited, "the call waited for the user's function"
    assert len(answers) == 1
    return answers[0]


def following(gate: Gate, **options: Any) -> tuple[TipController, float]:
    """A controller that follows the gate's reference and has taken some steps."""
    tip, plant = controller_for(**options), plant_for()
    tip.set_reference(gate)
    return tip, run(tip, plant, plant.reset(), 10)


@pytest.mark.parametrize("safe", [None, 0.0])
def test_a_stop_during_the_reference_is_honoured_by_that_step(safe: float | None) -> None:
    gate = Gate()
    tip, y = following(gate, ladder={"safe_command": safe})
    held, steps = tip.state().command, tip.snapshot().steps
    command = while_it_evaluates(tip, gate, y, tip.stop)
    assert command.source is Source.STOP
    assert command.u == pytest.approx(held if safe is None else max(held - LIMITS.rate * DT, safe))
    assert tip.snapshot().steps == steps + 1
    assert tip.state().stopped


def test_a_target_during_the_reference_is_what_that_step_follows() -> None:
    gate = Gate()
    tip, y = following(gate)
    command = while_it_evaluates(tip, gate, y, lambda: tip.set_reference(np.full(50, 60.0)))
    assert command.source is Source.MPC
    assert tip.plan().reference_deg[1] == 60.0
    tip.set_target(35.0)
    assert tip.step(y).source is Source.MPC


def test_a_reset_during_the_reference_is_not_lost() -> None:
    gate = Gate()
    tip, y = following(gate)
    command = while_it_evaluates(tip, gate, y, lambda: tip.reset(PLAY.y_rest))
    assert command.source is Source.MPC
    assert tip.snapshot().steps == 1
    assert tip.state().reference_deg == PLAY.y_rest


def test_a_restore_during_the_reference_is_not_lost() -> None:
    gate = Gate()
    tip, y = following(gate)
    early = tip.snapshot()
    tip.step(y)
    command = while_it_evaluates(tip, gate, y, lambda: tip.restore(early))
    assert command.source is Source.MPC
    assert tip.snapshot().steps == early.steps + 1


def test_a_target_set_while_the_old_reference_hangs_lets_a_stop_through() -> None:
    """`set_target` asks the old reference for its state of motion; that must not hold up a stop either."""
    gate = Gate()
    tip, y = following(gate)
    errors: list[Exception] = []

    def target() -> None:
        try:
            tip.set_target(60.0)
        except ControllerError as error:
            errors.append(error)

    gate.armed = True
    setting = Thread(target=target, daemon=True)
    setting.start()
    assert gate.entered.wait(GUARD_S)
    stopping = Thread(target=tip.stop, daemon=True)
    stopping.start()
    stopping.join(GUARD_S)
    waited = stopping.is_alive()
    gate.through.set()
    setting.join(GUARD_S)
    stopping.join(GUARD_S)
    assert not waited, "the stop waited for the user's function"
    assert len(errors) == 1  # the stop came first: there is no new reference after it
    assert tip.step(y).source is Source.STOP


def test_a_reference_that_stops_its_own_controller_is_obeyed() -> None:
    tip, plant = controller_for(), plant_for()

    def reference(t: float) -> float:
        if t > 0.5:
            tip.stop()
        return 40.0

    tip.set_reference(reference)
    run(tip, plant, plant.reset(), 20)
    assert tip.state().stopped
    assert tip.state().source is Source.STOP


def test_a_reference_that_replaces_itself_each_time_ends_in_a_hold() -> None:
    tip, plant = controller_for(), plant_for()
    y, armed = run(tip, plant, plant.reset(), 2), False

    def reference(t: float) -> float:
        nonlocal armed
        if armed:
            armed = False
            tip.set_reference(reference)
            armed = True
        return 40.0

    tip.set_reference(reference)
    armed = True
    command = tip.step(y)
    armed = False
    assert (command.source, command.u) == (Source.HOLD, tip.state().command)
    assert command.status == "reference: another was set each time this one was evaluated"
    assert tip.step(y).source is Source.MPC
