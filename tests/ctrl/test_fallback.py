"""The order of the fallbacks, their counters, and the latched stop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import Command, CommandLimits, ControlInput, Source, Stopwatch
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law import FallbackSettings, Law, Proposal
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.types import Vec

from .plays import PLAY

LIMITS = CommandLimits(0.0, 6.0, 12.0)
CASE = PLAY


class Switched(Predictor):
    """A sound model that fails while `broken` names the call."""

    def __init__(self, inner: Predictor) -> None:
        self.inner, self.dt, self.command_range = inner, inner.dt, inner.command_range
        self.broken: set[str] = set()

    def _check(self, call: str) -> None:
        if call in self.broken:
            raise RuntimeError(f"{call} is broken\non purpose")

    def initial(self, y: float, u: float) -> Vec:
        return self.inner.initial(y, u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        self._check("advance")
        return self.inner.advance(state, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        self._check("rollout")
        return self.inner.rollout(state, plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        self._check("linearise")
        return self.inner.linearise(state, plan)


class SwitchedInverse(Inverse):
    """An inverse that fails while `broken`, and gives another's `answer` where there is one."""

    def __init__(self, inner: Inverse) -> None:
        self.inner, self.broken, self.answer = inner, False, 0.0

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        if self.broken:
            raise ZeroDivisionError("no inverse")
        if self.answer:
            return self.answer
        return self.inner.command(state, theta, u_last)


class Bench:
    """A linearised controller on a model and an inverse that can be switched off."""

    def __init__(self, **ladder: Any) -> None:
        self.model, self.inverse = Switched(CASE.predictor), SwitchedInverse(CASE.inverse)
        settings = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc", "horizon": 5, "ladder": ladder})
        self.controller: GuardedController = build_controller(settings, self.model, self.inverse, LIMITS)
        self.state = self.controller.init(CASE.y_rest, CASE.u_rest)
        self.y = CASE.y_rest

    def step(self, wanted: Any = 45.0, y: float | None = None) -> Command:
        reference = np.full(5, wanted) if isinstance(wanted, float) else wanted
        command, self.state = self.controller.step(self.state, self.y if y is None else y, reference)
        if self.state.estimate.angles:
            self.y = self.state.estimate.angles[0]
        return command


@pytest.mark.parametrize("call", ["rollout", "linearise"])
def test_rungs_come_in_order_and_the_stop_stays(call: str) -> None:
    bench = Bench(stop_after_failures=8, safe_command=0.0)
    plan = bench.step().plan
    bench.model.broken = {call}
    sources = []
    for k in range(12):
        bench.inverse.broken = k >= 6
        command = bench.step(45.0 + k)  # a changing wish, so that holding is not the answer
        sources.append(command.source)
        if k < 4:
            assert command.u == pytest.approx(plan[k + 1])
        assert f"{call} is broken on purpose" in command.status or k >= 6
    assert sources == [Source.SHIFTED_PLAN] * 4 + [Source.INVERSE] * 2 + [Source.HOLD] + [Source.STOP] * 5
    bench.model.broken, bench.inverse.broken = set(), False
    assert bench.step().source is Source.STOP
    for _ in range(20):
        last = bench.step()
    assert last.u == 0.0
    assert last.status.startswith("stopped: latched")


@pytest.mark.parametrize("answer", [np.nan, np.inf, -np.inf])
def test_an_inverse_that_answers_no_number_is_passed_over(answer: float) -> None:
    bench = Bench()
    bench.model.broken, bench.inverse.answer = {"rollout"}, answer
    command = bench.step()
    assert (command.source, command.u) == (Source.HOLD, CASE.u_rest)
    assert "the inverse answers no finite command" in command.status


def test_stop_without_a_safe_command_stays_where_it_is() -> None:
    bench = Bench(stop_after_failures=1)
    u = bench.step().u
    bench.model.broken = {"rollout"}
    assert [bench.step().u for _ in range(5)] == [u] * 5


def test_success_clears_the_counters() -> None:
    bench = Bench(stop_after_failures=3)
    for _ in range(5):
        bench.step()
        bench.model.broken = {"rollout"}
        assert bench.step().source is Source.SHIFTED_PLAN
        assert bench.step().source is Source.SHIFTED_PLAN
        bench.model.broken = set()
        assert bench.step().source is Source.MPC
        assert bench.state.head.failures == 0


@pytest.mark.parametrize("wanted", [np.full(5, np.nan), np.full(4, 40.0), np.full((5, 1), 40.0), None, "up", np.inf])
def test_reference_that_cannot_be_followed_is_a_hold_and_no_failure(wanted: Any) -> None:
    bench = Bench(stop_after_failures=2)
    u = bench.step().u
    for _ in range(5):
        command = bench.step(wanted)
        assert (command.source, command.u) == (Source.HOLD, u)
        assert command.status.startswith("reference: ")
    assert bench.step().source is Source.MPC


def test_measurements_may_be_missing_for_a_while() -> None:
    bench = Bench(max_missing_samples=3, stop_after_failures=4)
    sources = [bench.step(y=np.nan).source for _ in range(8)]
    assert sources == [Source.MPC] * 3 + [Source.HOLD] * 3 + [Source.STOP] * 2


def test_model_whose_state_cannot_be_advanced_is_not_trusted() -> None:
    bench = Bench()
    bench.step()
    bench.model.broken = {"advance"}
    command = bench.step()
    assert "model state not advanced: RuntimeError: advance is broken on purpose" in command.status
    assert bench.state.estimate.stalled == 1
    assert "the model state is 1 samples old" in bench.step().status
    bench.model.broken = set()
    bench.step()
    assert bench.step().source is Source.MPC


class Answering(Law[int]):
    """A law that wants the same number whatever it sees; its memory counts how often it was asked."""

    horizon, source = 1, Source.CONTROLLER

    def __init__(self, answer: float) -> None:
        self.answer = answer

    def init(self, y: float, u: float) -> int:
        del y, u
        return 0

    def propose(self, memory: int, given: ControlInput, watch: Stopwatch) -> Proposal[int]:
        del given, watch
        return Proposal(self.answer, memory + 1)


@pytest.mark.parametrize("answer", [np.nan, np.inf, -np.inf])
def test_a_law_that_wants_no_number_has_failed(answer: float) -> None:
    """Limits alone would turn it into a hold that passes for the law's own; its memory is not kept either."""
    controller = Bench(stop_after_failures=3).controller.with_law(Answering(answer))
    state = controller.init(CASE.y_rest, CASE.u_rest)
    sources = []
    for _ in range(3):
        command, state = controller.step(state, CASE.y_rest, np.full(5, 45.0))
        sources.append(command.source)
        assert "the law answers no finite command" in command.status
    assert sources == [Source.INVERSE, Source.INVERSE, Source.STOP]
    assert state.law == 0


class Odd(Answering):
    """A law that answers anything."""

    def __init__(self, what: Any) -> None:
        self.what = what

    def propose(self, memory: int, given: ControlInput, watch: Stopwatch) -> Proposal[int]:
        del memory, given, watch
        return self.what


@pytest.mark.parametrize(
    "what",
    [None, 1.0, Proposal("x", 1), Proposal(1.0, 1, np.ones((2, 2))), Proposal(1.0, 1, np.array(["a"])),
     Proposal(1.0, 1, source="nobody")],
    ids=["nothing", "number", "text", "shape", "texts", "source"],
)  # fmt: skip
def test_a_law_that_answers_no_proposal_has_failed(what: Any) -> None:
    """What it raises or answers never passes through the engine as a success."""
    controller = Bench(stop_after_failures=3).controller.with_law(Odd(what))
    state = controller.init(CASE.y_rest, CASE.u_rest)
    command, state = controller.step(state, CASE.y_rest, np.full(5, 45.0))
    assert command.source is Source.INVERSE
    assert "Error" in command.status
    assert (state.law, state.head.failures) == (0, 1)


def test_pid_has_nothing_to_fall_back_on_but_a_hold() -> None:
    settings = CONTROLLERS["pid"].parse({"ladder": {"max_missing_samples": 0, "stop_after_failures": 3}})
    controller = build_controller(settings, CASE.predictor, CASE.inverse, LIMITS)
    state, sources = controller.init(30.0, 1.0), []
    for _ in range(4):
        command, state = controller.step(state, np.nan, np.array([50.0]))
        sources.append(command.source)
    assert sources == [Source.HOLD, Source.HOLD, Source.STOP, Source.STOP]


@pytest.mark.parametrize(("options", "text"), [((0, None), "stop_after_failures"), ((1, np.nan), "safe_command")])
def test_impossible_options_are_refused(options: tuple[int, float | None], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        FallbackSettings.parse({"stop_after_failures": options[0], "safe_command": options[1]})


def test_safe_command_beyond_the_limits_is_refused() -> None:
    with pytest.raises(ControllerError, match="expected one within"):
        Bench(stop_after_failures=3, safe_command=7.0)
