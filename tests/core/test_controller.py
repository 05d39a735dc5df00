"""Laws of the engine's controller, called as an exported one is: starts, memory, fallbacks, other senders."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.core.structs import constants, layout
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.problem import problem_of
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from ..ctrl.plays import LINEAR, Lag

C = constants()
LOWER, UPPER, RATE, H = 0.5, 5.0, 4.0, 5
START, FAR = 1.0, 150.0
LIMITS = CommandLimits(LOWER, UPPER, RATE)


class Failing(Predictor):
    """A model whose slopes are missing where `broken`."""

    def __init__(self, inner: Predictor) -> None:
        self.inner, self.dt, self.command_range, self.broken = inner, inner.dt, inner.command_range, False

    def initial(self, y: float, u: float) -> Vec:
        return self.inner.initial(y, u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        return self.inner.advance(state, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self.inner.rollout(state, plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        if self.broken:
            raise RuntimeError("no slopes")
        return self.inner.linearise(state, plan)


class Made:
    """A controller in the engine and its memory, in which nothing has been started."""

    def __init__(self, kind: str = "linearised_mpc", inverse: Inverse = LINEAR.inverse, **block: Any) -> None:
        self.model = Failing(LINEAR.predictor)
        more: dict[str, Any] = {"horizon": H, "adaptation": None, "supervisor": None} if "mpc" in kind else {}
        parsed = CONTROLLERS[kind].parse({"kind": kind, **more, **block})
        self.problem = problem_of(parsed, self.model, inverse, LIMITS)
        address = self.problem.address
        self.memory = np.zeros(engine().memory_bytes(address), np.uint8)
        self._room = np.empty(engine().room_bytes(address), np.uint8)
        self.y = Lag.b + Lag.g * START
        self.rest = self.model.initial(self.y, START)

    def _call(self, name: str, *given: Any) -> Any:
        return getattr(engine(), f"controller_{name}")(self.problem.address, self.memory, *given)

    def init(self, y: float | None = None, u: float = START) -> int:
        return int(self._call("init", self.rest, self.y if y is None else y, u, self._room))

    def step(self, y: float | None = None, wanted: float | None = None) -> Any:
        answer, plan = layout("hystmpc_command")(), np.empty((2, H))
        reference = None if wanted is None else np.full(H, wanted)
        address = ctypes.addressof(answer)
        self._call("step", self.y if y is None else y, reference, address, plan, self._room)
        return answer

    def look_on(self, y: float, u: float) -> int:
        return int(self._call("look_on", y, u, self._room))

    def tell(self, name: str, *given: float) -> None:
        """Call a function that answers nothing: `stop`, `hurry`, `target`, `held`."""
        self._call(name, *given)

    @property
    def head(self) -> Any:
        return layout("hystmpc_head").from_buffer(self.memory)

    @property
    def known(self) -> Any:
        behind = -(-ctypes.sizeof(layout("hystmpc_head")) // 8) * 8
        return layout("hystmpc_known").from_buffer(self.memory, behind)  # type: ignore[call-arg]


@pytest.fixture
def made() -> Made:
    """On its way up, one step after its start."""
    controller = Made()
    assert controller.init() == C["HYSTMPC_STARTED"]
    controller.tell("target", FAR)
    assert controller.step().source == C["HYSTMPC_MPC"]
    return controller


@pytest.mark.parametrize("byte", [0, 171])
def test_what_was_never_started_stands_still(byte: int) -> None:
    made = Made()
    made.memory[:] = byte
    for _ in range(3):
        answer = made.step(wanted=FAR)
        assert (answer.u, answer.source, answer.status) == (LOWER, C["HYSTMPC_STOP"], C["HYSTMPC_LATCHED"])
        assert made.look_on(made.y, 3.0) == 1


@pytest.mark.parametrize(("held", "u"), [(3.0, 3.0), (9.0, UPPER), (0.0, LOWER), (math.nan, LOWER), (math.inf, LOWER)])
def test_where_a_start_is_refused_the_device_stays_within_its_limits(held: float, u: float) -> None:
    made = Made()
    assert made.init(math.nan, held) == C["HYSTMPC_BAD_ANGLE"]
    answer = made.step(wanted=FAR)
    assert (answer.u, answer.source) == (u, C["HYSTMPC_STOP"])


@pytest.mark.parametrize(
    ("y", "held", "answer"),
    [
        (math.nan, START, "BAD_ANGLE"),
        (1.1e4, START, "BAD_ANGLE"),
        (None, math.nan, "BAD_COMMAND"),
        (None, UPPER + 1e-9, "BAD_COMMAND"),
        (None, LOWER - 1e-9, "BAD_COMMAND"),
        (170.0, START, "NOT_AT_REST"),
    ],
)
def test_a_refused_start_stops_a_controller_that_runs(made: Made, y: float | None, held: float, answer: str) -> None:
    sent = made.step().u
    assert sent > START
    assert made.init(y, held) == C[f"HYSTMPC_{answer}"]
    for _ in range(3):
        stopped = made.step()
        assert (stopped.u, stopped.source, stopped.status) == (sent, C["HYSTMPC_STOP"], C["HYSTMPC_LATCHED"])


def test_an_accepted_start_releases_the_stop_and_forgets_what_was_before(made: Made) -> None:
    made.tell("hurry")
    made.tell("stop")
    assert made.step().source == C["HYSTMPC_STOP"]
    assert made.init() == C["HYSTMPC_STARTED"]
    assert (made.head.stopped, made.head.failures, made.head.planned) == (0, 0, 0)
    answer = made.step()
    assert (answer.source, answer.u) == (C["HYSTMPC_MPC"], START)  # the target is the angle of the start


def test_a_stop_lasts_whatever_is_measured_and_wanted(made: Made) -> None:
    sent = made.step().u
    made.tell("stop")
    for wanted in (None, 20.0, FAR, math.nan):
        answer = made.step(wanted=wanted)
        assert (answer.u, answer.source, made.head.stopped) == (sent, C["HYSTMPC_STOP"], 1)


def test_a_hurry_is_that_of_one_sample(made: Made) -> None:
    made.tell("hurry")
    answer = made.step()
    assert (answer.source, answer.status) == (C["HYSTMPC_SHIFTED_PLAN"], C["HYSTMPC_NO_TIME"])
    assert made.head.failures == 1
    answer = made.step()
    assert (answer.source, answer.status, made.head.failures) == (C["HYSTMPC_MPC"], C["HYSTMPC_OK"], 0)


@pytest.mark.parametrize(
    ("sent", "held"), [(2.0, 2.0), (9.0, UPPER), (-1.0, LOWER), (math.nan, None), (math.inf, None)]
)
def test_who_looks_on_goes_on_from_what_the_other_sent(made: Made, sent: float, held: float | None) -> None:
    """What is no number leaves the command; the plan of before is not taken up again."""
    expected, before = made.known.command if held is None else held, state_of(made)
    assert made.look_on(made.y, sent) == 0
    assert made.known.command == expected
    np.testing.assert_array_equal(state_of(made), LINEAR.predictor.advance(before, expected)[1])
    assert made.head.planned == 0
    made.tell("hurry")
    answer = made.step()
    assert answer.source == C["HYSTMPC_INVERSE"]
    assert abs(answer.u - expected) <= RATE * made.model.dt + 1e-12


def state_of(made: Made) -> Vec:
    """State of the model after every command sent."""
    x, numbers = np.empty(made.rest.size), np.empty(16)
    engine().controller_look(made.problem.address, made.memory, numbers, x, None, None, None, None)
    return x


def test_the_model_gets_what_was_sent(made: Made) -> None:
    """Far from the wanted angle that is less than what was proposed."""
    made.tell("hurry")
    made.head.planned = 0
    before = state_of(made)
    answer = made.step(wanted=1e3)
    assert (answer.source, made.known.command) == (C["HYSTMPC_INVERSE"], answer.u)
    np.testing.assert_array_equal(state_of(made), LINEAR.predictor.advance(before, answer.u)[1])


@pytest.mark.parametrize("held", [-7.0, 7.0])
def test_a_held_command_beyond_the_limits_is_left_at_once(made: Made, held: float) -> None:
    made.tell("held", held)
    assert LOWER <= made.step().u <= UPPER


@pytest.mark.parametrize("count", [-1, 6, 2**31 - 1, -(2**31)])
@pytest.mark.parametrize("kind", ["linearised_mpc", "inverse_pid"])
def test_counts_of_a_memory_from_elsewhere_are_kept_within_it(kind: str, count: int) -> None:
    """They are used as lengths."""
    made = Made(kind)
    assert made.init() == C["HYSTMPC_STARTED"]
    head = made.head
    head.planned = head.fed = head.dues = count
    made.tell("target", FAR)  # any function of a memory
    horizon = made.problem.fields["law"].fields["horizon"]
    assert 0 <= head.planned <= horizon
    assert 0 <= head.fed <= horizon
    assert 0 <= head.dues <= made.problem.fields["sensing"].fields.get("oldest", 0) + 1


def test_a_law_that_fails_remembers_nothing(made: Made) -> None:
    """What it had changed before is put back: here the count of samples of a constant reference."""
    for k in range(3):
        made.step(wanted=40.0 + k)
    made.model.broken = True
    before = made.head.constant, made.head.hold_target, made.head.holding
    answer = made.step(wanted=90.0)
    assert answer.status == C["HYSTMPC_FAILED"]
    assert (made.head.constant, made.head.hold_target, made.head.holding) == before


def test_a_plan_is_not_taken_up_after_a_pause(made: Made) -> None:
    """In between the command was held, so that the rest of the plan begins elsewhere."""
    assert made.head.planned > 0
    assert made.step(wanted=math.nan).source == C["HYSTMPC_HOLD"]
    made.tell("hurry")
    assert made.step().source == C["HYSTMPC_INVERSE"]


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -math.inf, 1.1e4])
def test_a_wanted_angle_that_is_none_is_a_hold_and_no_failure(made: Made, wanted: float) -> None:
    sent, failures = made.known.command, made.head.failures
    answer = made.step(wanted=wanted)
    assert (answer.u, answer.source, answer.status) == (sent, C["HYSTMPC_HOLD"], C["HYSTMPC_BAD_REFERENCE"])
    assert made.head.failures == failures


def test_the_inverse_that_is_fallen_back_on_knows_the_disturbance() -> None:
    """A device 10 deg above its model needs less of the command for an angle."""
    made = Made(estimator={"outlier_deg": 60.0, "disturbance_limit_deg": 60.0})
    assert made.init(made.y + 10.0) == C["HYSTMPC_STARTED"]
    for _ in range(3):
        made.tell("hurry")
        answer = made.step(made.y + 10.0, made.y + 10.0)
        assert answer.source == C["HYSTMPC_INVERSE"]
        assert answer.u == pytest.approx(START, abs=0.02)


def test_missing_measurements_are_counted_bridged_and_then_a_failure() -> None:
    made = Made(ladder={"max_missing_samples": 2, "stop_after_failures": 3})
    assert made.init() == C["HYSTMPC_STARTED"]
    answers = [made.step(math.nan, FAR) for _ in range(6)]
    assert [answer.missing for answer in answers] == [1, 2, 3, 4, 5, 6]
    names = ["MPC"] * 2 + ["HOLD"] * 2 + ["STOP"] * 2
    assert [answer.source for answer in answers] == [C[f"HYSTMPC_{name}"] for name in names]
    assert made.step().source == C["HYSTMPC_STOP"]  # it measures again


def test_an_integral_does_not_run_ahead_of_the_rate_limit() -> None:
    """Where the error ends, the command does not rise on."""
    made = Made("pid")
    assert made.init() == C["HYSTMPC_STARTED"]
    sent = [made.step(wanted=made.y + 20.0).u for _ in range(15)]
    np.testing.assert_allclose(np.diff(sent[5:]), RATE * made.model.dt)
    assert made.step(wanted=made.y).u < sent[-1]
