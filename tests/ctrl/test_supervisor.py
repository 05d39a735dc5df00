"""Laws of the supervisor: bumpless transfer, and feedback where the forecasts are worthless."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits, Source
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.feedback import LEVELS, PidSettings, SupervisorSettings, feedback_gains
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.problem import problem_of
from hystmpc.trials.errors import ConfigError

from .plays import DT, SOUND, Backlash
from .scripted import Scripted, scripted

LIMITS = CommandLimits(0.0, 6.0, 10.0)
GAINS = {"kp_per_deg": 0.02, "ki_per_deg_s": 0.15}
THRESHOLDS = SupervisorSettings()


def asked(**block: Any) -> LinearisedMpcSettings:
    return LinearisedMpcSettings.parse({"kind": "linearised_mpc", **block})


def controller() -> tuple[GuardedController, Scripted]:
    """A supervised controller, and its observer, which says how bad the forecasts have been."""
    case = SOUND[0]
    return scripted(asked(supervisor={"pid": GAINS}), case.predictor, case.inverse, LIMITS)


def expected(level: int, forecast_error: float) -> int:
    """A level is left above its threshold, and taken again below half of it."""
    thresholds = np.array([THRESHOLDS.inverse_pid_above, THRESHOLDS.pid_above])
    worst, best = int(np.sum(forecast_error > thresholds)), int(np.sum(forecast_error > 0.5 * thresholds))
    return max(worst, min(level, best))


@given(
    forecast_errors=st.lists(st.floats(0.0, 1.2), min_size=1, max_size=25),
    wanted=st.floats(30.0, 80.0),
    drift=st.floats(-0.5, 0.5),
)
@example(forecast_errors=[0.1, 1.0, 1.15, 0.1, 1.15, 1.0], wanted=60.0, drift=0.2)
@settings(max_examples=40, deadline=None)
def test_the_transfer_to_feedback_is_bumpless(forecast_errors: list[float], wanted: float, drift: float) -> None:
    """Whatever the forecasts do, limits hold, and the first command of a law that takes over is the last one sent."""
    (loop, script), y = controller(), 40.0
    state = loop.init(y, 1.5)
    for script.forecast_error in forecast_errors:
        before, level = state.estimate.command, state.head.level
        script.disturbance = y - state.estimate.angles[0]
        reference = wanted + drift * np.arange(loop.horizon)
        command, state = loop.step(script.written(state), y, reference)
        assert state.head.failures == 0
        assert state.head.level == expected(level, script.forecast_error)
        assert LIMITS.lower <= command.u <= LIMITS.upper
        assert abs(command.u - before) <= LIMITS.rate * DT + 1e-12
        if state.head.level not in (level, 0):
            assert command.u == pytest.approx(before, abs=1e-9)
        y += 0.3 * float(np.tanh(command.u - before))


@pytest.mark.parametrize(
    ("forecast_error", "level", "source"),
    [(0.1, "mpc", Source.MPC), (1.0, "inverse_pid", Source.CONTROLLER), (1.15, "pid", Source.CONTROLLER)],
)
def test_the_level_follows_the_forecasts_and_stands_in_the_log(
    forecast_error: float, level: str, source: Source
) -> None:
    loop, script = controller()
    script.forecast_error = forecast_error
    command, state = loop.step(script.written(loop.init(40.0, 1.5)), 40.0, np.full(loop.horizon, 45.0))
    assert LEVELS[state.head.level] == level
    assert command.source == source
    assert command.status == (
        "ok" if level == "mpc" else f"{level}: forecasts are off by {100 * forecast_error:.0f} % of the motion"
    )


@pytest.mark.parametrize(
    ("first", "then", "level"),
    [
        (1.15, 0.9 * THRESHOLDS.pid_above, "pid"),
        (1.15, 0.4 * THRESHOLDS.inverse_pid_above, "mpc"),
        (0.0, 0.9 * THRESHOLDS.inverse_pid_above, "mpc"),
    ],
)
def test_a_better_level_takes_over_only_where_forecasts_are_twice_as_good(
    first: float, then: float, level: str
) -> None:
    loop, script = controller()
    state, reference = loop.init(40.0, 1.5), np.full(loop.horizon, 45.0)
    for script.forecast_error in (first, then):
        _, state = loop.step(script.written(state), 40.0, reference)
    assert LEVELS[state.head.level] == level


class Stranger:
    """A device that no model here foretells: its angle answers the other way for a while, at random times."""

    def __init__(self, seed: int) -> None:
        self.random, self.y, self.way, self.u = np.random.default_rng(seed), 45.0, 1.0, 2.0

    def apply(self, u: float) -> float:
        if self.random.random() < 0.05:
            self.way = -self.way
        self.y += 0.2 * ((45.0 + 4.0 * self.way * (u - 2.0)) - self.y)
        return self.y + 0.05 * float(self.random.standard_normal())


@pytest.mark.slow
def test_worthless_forecasts_end_in_feedback_within_limits() -> None:
    case, device = SOUND[0], Stranger(3)
    loop = build_controller(asked(supervisor={"pid": GAINS}), case.predictor, case.inverse, LIMITS)
    state, y, last, levels = loop.init(45.0, 2.0), 45.0, 2.0, []
    for k in range(1500):
        wanted = 45.0 + 4.0 * np.sin(0.15 * (k + np.arange(1, loop.horizon + 1)))
        command, state = loop.step(state, y, wanted)
        assert abs(command.u - last) <= LIMITS.rate * DT + 1e-12
        y, last = device.apply(command.u), command.u
        levels.append(LEVELS[state.head.level])
    assert {"inverse_pid", "pid"} & set(levels)


def test_gains_that_nobody_gave_follow_from_the_static_gain() -> None:
    gains = feedback_gains(SupervisorSettings(), Backlash())
    assert gains.ki_per_deg_s == pytest.approx(1.5 / 10.4, rel=0.05)
    given_ = PidSettings(kp_per_deg=0.5)
    assert feedback_gains(SupervisorSettings(pid=given_), Backlash()) == given_


def test_without_learning_there_is_no_supervisor() -> None:
    case = SOUND[0]
    for block in ({"adaptation": None}, {"supervisor": None}, {"estimator": {"sensor": "none"}}):
        law = problem_of(asked(**block), case.predictor, case.inverse, LIMITS).fields["law"]
        assert not law.fields.get("supervised")


def test_settings_say_what_is_off_and_a_supervisor_without_learning_is_refused() -> None:
    kind = CONTROLLERS["linearised_mpc"]
    frames = {"estimator": {"sensor": "intermittent"}}
    for block in ({"adaptation": None}, frames, {"estimator": {"sensor": "none"}}):
        plain = kind.parse({"kind": "linearised_mpc", **block}).model_dump(mode="json")
        assert plain["supervisor"] is None
        assert (plain["adaptation"] is None) == (block != frames)
        assert kind.parse(plain).model_dump(mode="json") == plain
    with pytest.raises(ConfigError, match="expected supervisor null"):
        kind.parse({"kind": "linearised_mpc", "adaptation": None, "supervisor": {}})


@pytest.mark.parametrize("sensor", ["none", "intermittent"])
def test_a_commissioned_controller_serves_another_sensor(sensor: str) -> None:
    """`tip.yaml` names the gains of a supervisor; without a continuous sensor there is none, and no error."""
    block = {"kind": "linearised_mpc", "supervisor": {"pid": GAINS}, "estimator": {"sensor": sensor}}
    parsed = CONTROLLERS["linearised_mpc"].parse(block)
    assert parsed.supervisor is None
    assert CONTROLLERS["linearised_mpc"].parse(parsed.model_dump()) == parsed
