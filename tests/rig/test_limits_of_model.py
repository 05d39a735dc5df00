"""Limits wider than the model's are refused before anything moves, unless a key says that they are meant."""

from __future__ import annotations

import copy
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.cli.main import main
from hystmpc.ctrl import CommandLimits, TipController
from hystmpc.ctrl.command import ModelledLimitsSettings, modelled_limits
from hystmpc.rig.config import RunSettings
from hystmpc.rig.device import DeviceSettings
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.record import RecordSettings
from hystmpc.sim.config import SimulationConfig
from hystmpc.sim.study import prepare
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, ControllerError

RUN: dict[str, Any] = {
    "name": "bench",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "safe_command": 0,
    "sensor": {"lower_deg": 0, "upper_deg": 120},
    "transport": {"kind": "simulated", "plant": {"simulator": "builtin:tendon-catheter"}},
    "controller": {"model": "builtin:backlash", "controller": {"kind": "inverse"}},
    "reference": {"kind": "point_to_point", "start_deg": 35, "targets_deg": [50], "holds_s": [1]},
}
STUDY: dict[str, Any] = {
    "plant": {"simulator": "builtin:tendon-catheter"},
    "model": "builtin:backlash",
    "motions": {"move": {"kind": "point_to_point", "start_deg": 30, "targets_deg": [50], "holds_s": [1]}},
    "controllers": {"inverse": {"kind": "inverse"}},
}
MODEL = "0 to 6 at 10 per s"  # builtin:backlash
WIDE = [
    ({"lower": 0, "upper": 60, "rate_per_s": 10}, "0 to 60 at 10 per s"),
    ({"lower": -1, "upper": 6, "rate_per_s": 10}, "-1 to 6 at 10 per s"),
    ({"lower": 0, "upper": 6, "rate_per_s": 10.5}, "0 to 6 at 10.5 per s"),
]


def run_settings(**changes: Any) -> RunSettings:
    return RunSettings.parse({**copy.deepcopy(RUN), **changes})


def refusal(error: pytest.ExceptionInfo[Exception], got: str) -> None:
    text = str(error.value)
    assert f"got {got}, expected them within what the model was made for, {MODEL}" in text
    assert "limits.beyond_model: true" in text
    assert "\n" not in text


@pytest.mark.parametrize(("limits", "got"), WIDE)
def test_a_planner_gets_no_wider_limits_than_its_model(limits: dict[str, float], got: str) -> None:
    config = {"model": "builtin:backlash", "controller": {"kind": "inverse"}, "limits": limits}
    with pytest.raises(ControllerError) as error:
        TipController.from_config(config)
    refusal(error, got)
    wide = TipController.from_config({**config, "limits": {**limits, "beyond_model": True}})
    assert wide.step(35.0).u <= limits["upper"]


@pytest.mark.parametrize(("limits", "got"), WIDE)
def test_an_experiment_gets_no_wider_limits_than_its_model(limits: dict[str, float], got: str) -> None:
    with pytest.raises(ControllerError) as error:
        tracking_phase(run_settings(limits=limits))
    refusal(error, got)
    tracking_phase(run_settings(limits={**limits, "beyond_model": True}))


def test_a_bench_wider_than_the_model_is_refused_though_its_controller_is_not() -> None:
    """Preparation and the gate before the wire go by the limits of the bench."""
    limits, got = WIDE[0]
    controller = {**RUN["controller"], "limits": RUN["limits"]}
    with pytest.raises(ControllerError) as error:
        tracking_phase(run_settings(limits=limits, controller=controller))
    refusal(error, got)
    tracking_phase(run_settings(limits={**limits, "beyond_model": True}, controller=controller))


def test_a_controller_wider_than_the_model_is_refused_though_the_bench_may_be() -> None:
    limits, got = WIDE[0]
    bench, controller = {**limits, "beyond_model": True}, {**RUN["controller"], "limits": limits}
    with pytest.raises(ControllerError) as error:
        tracking_phase(run_settings(limits=bench, controller=controller))
    refusal(error, got)


def test_a_controller_wider_than_the_bench_is_refused_key_or_not() -> None:
    controller = {**RUN["controller"], "limits": {**WIDE[0][0], "beyond_model": True}}
    with pytest.raises(ConfigError, match=r"got limits 0 to 60 at 10 per s, expected them within the bench's 0 to 6"):
        tracking_phase(run_settings(controller=controller))


@pytest.mark.parametrize(("limits", "got"), WIDE)
def test_a_study_gets_no_wider_limits_than_its_model(limits: dict[str, float], got: str) -> None:
    with pytest.raises(ControllerError) as error:
        prepare(SimulationConfig.parse({**STUDY, "limits": limits}))
    refusal(error, got)
    ready = prepare(SimulationConfig.parse({**STUDY, "limits": {**limits, "beyond_model": True}}))
    assert ready.limits == CommandLimits(limits["lower"], limits["upper"], limits["rate_per_s"])
    own = {"kind": "inverse", "limits": {"lower": -2, "upper": 70, "rate_per_s": 20}}
    with pytest.raises(ControllerError, match="expected them within those of the device"):
        prepare(SimulationConfig.parse({**STUDY, "controllers": {"inverse": own}}))


def test_the_settings_of_a_prepared_study_repeat_it() -> None:
    ready = prepare(SimulationConfig.parse(STUDY))
    again = prepare(SimulationConfig.parse(ready.config.model_dump(mode="json")))
    assert again.limits == ready.limits == CommandLimits(0.0, 6.0, 10.0)


@pytest.mark.parametrize("written", ["yes", 1, "true", None, 0.0])
def test_the_key_is_true_or_false_and_nothing_like_it(written: Any) -> None:
    with pytest.raises(ConfigError, match=r"limits\.beyond_model: "):
        run_settings(limits={**WIDE[0][0], "beyond_model": written})


def test_the_key_is_unknown_where_there_is_no_model() -> None:
    limits = {**RUN["limits"], "beyond_model": True}
    shared = {key: RUN[key] for key in ("name", "rate_hz", "command_unit", "safe_command", "sensor", "transport")}
    excitations = {"steps": {"kind": "ramps", "start": 0, "stops": [3, 0], "holds_s": [1, 1]}}
    with pytest.raises(ConfigError, match=r"limits: unknown key 'beyond_model'"):
        RecordSettings.parse({**shared, "limits": limits, "excitations": excitations})
    device = {"rate_hz": 25, "command_unit": "mm", "plant": {}, "link": {"kind": "udp"}, "limits": limits}
    with pytest.raises(ConfigError, match=r"limits: unknown key 'beyond_model'"):
        DeviceSettings.parse(device)
    own = {"kind": "inverse", "limits": limits}
    with pytest.raises(ConfigError, match="unknown key 'beyond_model'"):
        SimulationConfig.parse({**STUDY, "controllers": {"inverse": own}})


def test_the_program_refuses_before_anything_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`limits.upper=60` on a model of 6 mm: exit code 2, one line, no run folder, no latch."""
    file = tmp_path / "bench.yaml"
    file.write_text(dump_yaml({**RUN, "latch_file": str(tmp_path / "latch.json")}))
    arguments = ["run", str(file), "--out", str(tmp_path / "run"), "--set", "limits.upper=60"]
    before, sys.argv = sys.argv, ["hystmpc", *arguments]
    try:
        with pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = before
    error = capsys.readouterr().err
    assert end.value.code == 2
    assert error.startswith("error: limits: got 0 to 60 at 10 per s, expected them within what the model was made for")
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / "latch.json").exists()


numbers = st.floats(-100.0, 100.0)


@settings(max_examples=200)
@given(numbers, st.floats(0.01, 50.0), st.floats(0.01, 50.0), numbers, st.floats(0.01, 50.0), st.floats(0.01, 50.0))
def test_what_is_taken_lies_within_the_model(
    lower: float, width: float, rate: float, other: float, span: float, speed: float
) -> None:
    model = CommandLimits(lower, lower + width, rate)
    wanted = ModelledLimitsSettings(lower=other, upper=other + span, rate_per_s=speed)
    limits = CommandLimits(wanted.lower, wanted.upper, wanted.rate_per_s)
    assert modelled_limits(None, model) == model
    assert modelled_limits(wanted.model_copy(update={"beyond_model": True}), model) == limits
    try:
        taken = modelled_limits(wanted, model)
    except ControllerError:
        assert limits.lower < model.lower or limits.upper > model.upper or limits.rate > model.rate
    else:
        assert taken == limits
        slack = 1e-8 * width
        assert model.lower - slack <= taken.lower < taken.upper <= model.upper + slack
        assert taken.rate <= model.rate * (1 + 1e-8)
