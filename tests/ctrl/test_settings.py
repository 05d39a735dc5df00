"""Settings of the controllers, and what building refuses."""

from __future__ import annotations

from typing import Any

import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS, parse_controller
from hystmpc.trials.errors import ConfigError, ControllerError

from .plays import LINEAR, PLAY

LIMITS = CommandLimits(0.0, 6.0, 12.0)


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_kind_builds_from_its_name_alone(kind: str) -> None:
    settings = parse_controller({"kind": kind})
    assert settings.kind == kind
    controller = build_controller(settings, PLAY.predictor, PLAY.inverse, LIMITS)
    assert controller.dt == PLAY.predictor.dt
    assert controller.horizon >= 1


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_settings_survive_a_round_trip(kind: str) -> None:
    settings = parse_controller({"kind": kind, "limits": {"lower": 0, "upper": 5, "rate_per_s": 3}})
    assert parse_controller(settings.model_dump()) == settings


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"kind": "linearized_mpc"}, "did you mean 'linearised_mpc'"),
        ({"horizon": 3}, "got neither kind nor python"),
        ({"kind": "pid", "horizon": 3}, "unknown key 'horizon'"),
        ({"kind": "pid", "gains": {"kp_deg": 1.0}}, "did you mean 'kp_per_deg'"),
        ({"kind": "inverse", "limits": {"lower": 2, "upper": 1, "rate_per_s": 1}}, "expected lower < upper"),
        ({"kind": "sampling_mpc", "noise": {"kind": "pink"}}, "noise"),
        ({"kind": "linearised_mpc", "solver_eps": 1e-3}, "solver_eps"),
        (
            {"kind": "linearised_mpc", "move_blocking": [5, 20]},
            "25 samples together, expected at most the horizon of 20",
        ),
        ({"kind": "linearised_mpc", "move_blocking": [1, 0]}, "move_blocking"),
        ({"kind": "linearised_mpc", "move_blocking": []}, "move_blocking"),
        ({"kind": "linearised_mpc", "move_blockings": [1]}, "did you mean 'move_blocking'"),
        ({"kind": "sampling_mpc", "move_blocking": [1]}, "unknown key 'move_blocking'"),
    ],
)
def test_wrong_settings_end_in_one_clear_line(data: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        parse_controller(data, "c.yaml")
    assert str(caught.value).startswith("c.yaml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"kind": "pid", "limits": {"lower": 0, "upper": 7, "rate_per_s": 3}}, "within those of the device"),
        ({"kind": "pid", "gains": {"tracking_s": 0.01}}, "expected at least the sample time"),
        ({"kind": "sampling_mpc", "horizon": 4, "noise": {"kind": "spline"}}, "expected 2 to the horizon of 4"),
        ({"kind": "inverse", "ladder": {"safe_command": 9}}, "safe_command"),
        ({"kind": "linearised_mpc", "weights": {"angle_lower_deg": 9, "angle_upper_deg": 8}}, "angle_limits_deg"),
    ],
)
def test_settings_that_contradict_the_device_are_refused(data: dict[str, Any], text: str) -> None:
    with pytest.raises(ControllerError, match=text):
        build_controller(parse_controller(data), PLAY.predictor, PLAY.inverse, LIMITS)


def test_limits_of_the_settings_narrow_those_of_the_device() -> None:
    settings = parse_controller({"kind": "inverse", "limits": {"lower": 1, "upper": 2, "rate_per_s": 1}})
    controller = build_controller(settings, LINEAR.predictor, LINEAR.inverse, LIMITS)
    state = controller.init(30.0, 1.0)
    for _ in range(40):
        command, state = controller.step(state, 30.0, [90.0])  # type: ignore[arg-type]
    assert command.u == 2.0
