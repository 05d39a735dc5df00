"""Controllers as linear systems: the engine's own commands, margins against the loops they speak of."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

import hystmpc
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.feedback import PidControllerSettings, PidSettings
from hystmpc.ctrl.linear.analysis import ControllerAnalysis, DeviceModel, analyse_controllers
from hystmpc.ctrl.linear.design import gains_by_margin
from hystmpc.ctrl.linear.laws import pid_system, predictive_system
from hystmpc.ctrl.linear.limit_cycles import PidLoop
from hystmpc.ctrl.linear.margins import LoopMargins, is_stable, margins_of
from hystmpc.ctrl.linear.report import loops_of
from hystmpc.ctrl.loop import run_loop
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.linear.systems import LinearPart
from hystmpc.models.model import LoadedModel
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import ControllerError

from .plays import ModelPlant
from .test_limit_cycles import DT, compiled_of

WIDE = CommandLimits(0.0, 6.0, 100.0)


def model_of(*operators: Operator) -> LoadedModel:
    return ChainModel(compiled_of(*operators), "conditioned")


@pytest.mark.parametrize("gains", [{"kp_per_deg": 0.01}, {"kd_s_per_deg": 0.003}, {"ki_per_deg_s": 0.0}])
def test_the_pid_is_that_of_the_engine(gains: dict[str, float]) -> None:
    """Within the limits, without a dead zone, the commands of a sequence of readings are those of the linear system."""
    settings = PidControllerSettings(gains=PidSettings(**{"dead_zone_deg": 0.0, **gains}))
    controller = hystmpc.build_controller(settings, model_of(Line(10.0, 20.0)), limits=WIDE)
    readings = 50.0 + np.random.default_rng(0).normal(0.0, 1.0, 60)
    readings[0] = 50.0
    state, sent = controller.init(50.0, 3.0), []
    for y in readings:
        command, state = controller.step(state, float(y), np.full(controller.horizon, 50.0))
        sent.append(command.u - 3.0)
    system = pid_system(settings.gains, DT)
    linear = control.forced_response(system, DT * np.arange(60), 50.0 - readings, np.zeros(system.nstates))
    np.testing.assert_allclose(sent, np.ravel(linear.outputs), atol=1e-9)


def resting_law(delay: int) -> LinearisedMpcSettings:
    """A law without learning, hold and limits on corrections."""
    sigmas = {"sensor_sigma_deg": 0.15, "drift_sigma_deg_per_sqrt_s": 0.4, "motion_sigma_deg_per_sqrt_unit": 0.0}
    return LinearisedMpcSettings.parse(
        {
            "adaptation": None,
            "estimator": {**sigmas, "delay_samples": delay},
            "weights": {"rate": 3.0},
            "hold": {"tolerance_deg": 0.0, "settle_s": 0.0, "patience_s": 1e6, "settle_after_s": 1e6},
        }
    )


@pytest.mark.parametrize("delay", [0, 3])
def test_the_predictive_law_is_that_of_the_engine(delay: int) -> None:
    """Once its gain has settled, the engine answers readings with the commands of the linear system."""
    settings, model = resting_law(delay), model_of(Lag(0.1), Line(10.0, 20.0))
    controller = hystmpc.build_controller(settings, model, limits=WIDE)
    state, still, more = controller.init(50.0, 3.0), 400, 60
    k = np.arange(more)
    readings = np.append(np.full(still, 50.0), 50.0 + (k >= 2) * (0.4 + 0.3 * np.sin(k)))
    sent = []
    for i, y in enumerate(readings):  # a reference that moves by nothing to speak of: a plan is made in each sample
        command, state = controller.step(state, float(y), np.full(controller.horizon, 50.0 + 1e-9 * (-1) ** i))
        sent.append(command.u - 3.0)
    device = DeviceModel(model, 0.0, 0, 3.0)
    gain = settings.estimator.observer(controller_model(model).predictive[0]).greatest_gain
    law = predictive_system(settings, device.without_delay, DT, gain)
    linear = control.forced_response(law, DT * k, 50.0 - readings[still:], np.zeros(law.nstates))
    np.testing.assert_allclose(sent[still:], np.ravel(linear.outputs), atol=2e-5)
    assert np.ptp(linear.outputs) > 0.05


@pytest.mark.parametrize(("sensor", "drift"), [(0.15, 0.4), (2.0, 0.1)])
def test_the_gain_of_given_sigmas_is_that_of_the_library(sensor: float, drift: float) -> None:
    given = EstimatorSettings(
        sensor_sigma_deg=sensor, drift_sigma_deg_per_sqrt_s=drift, motion_sigma_deg_per_sqrt_unit=0.0
    )
    one, predictor = np.eye(1), controller_model(model_of(Line(10.0, 20.0))).predictive[0]
    gain, _, _ = control.dlqe(one, one, one, drift**2 * DT * one, sensor**2 * one, method="scipy")
    assert given.observer(predictor).greatest_gain == pytest.approx(float(np.asarray(gain).item()), rel=1e-9)
    assert EstimatorSettings().observer(predictor).greatest_gain == pytest.approx(0.5)  # the bound of a bank at 25 Hz


def test_a_model_with_a_direct_part_is_no_model_of_a_plan() -> None:
    part = LinearPart(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)))
    with pytest.raises(ControllerError, match="got a model with a direct part"):
        predictive_system(LinearisedMpcSettings(), part, DT, 0.5)


def integral_loop(gain: float) -> object:
    """L(z) = g dt / (z - 1) with one sample of delay: stable up to g dt = 1."""
    return control.tf([gain * DT], [1.0, -1.0, 0.0], DT)


def test_margins_are_what_the_loop_survives() -> None:
    loop = integral_loop(5.0)
    margins = margins_of(loop)
    assert margins.stable
    assert margins.gain == pytest.approx(1.0 / (5.0 * DT), rel=1e-3)
    for factor in (0.999, 1.001):
        assert is_stable(loop * factor * margins.gain) == (factor < 1.0)  # type: ignore[operator]
    assert margins.delay_samples is not None
    late = [control.tf([1.0], [1.0] + [0.0] * (margins.delay_samples + more), DT) for more in (0, 1)]
    assert [is_stable(loop * one) for one in late] == [True, False]  # type: ignore[operator]
    z = np.exp(1j * np.linspace(1e-3, math.pi, 20_000))
    assert margins.sensitivity == pytest.approx(np.max(np.abs(1.0 / (1.0 + loop(z)))), rel=1e-3)  # type: ignore[operator]
    assert margins.disk_gain <= margins.gain


def test_an_unstable_loop_has_no_margin() -> None:
    margins = margins_of(integral_loop(26.0))
    assert (margins.stable, margins.delay_samples, margins.lag_s) == (False, -1, 0.0)
    assert math.isinf(margins.settling_s)


def test_the_settling_time_is_that_of_the_slowest_pole() -> None:
    assert margins_of(integral_loop(1.0)).settling_s == pytest.approx(
        DT * math.log(0.02) / math.log(0.5 + math.sqrt(0.25 - DT)), rel=1e-9
    )


def analysed(kind: str, model: LoadedModel, **more: object) -> ControllerAnalysis:
    settings = parse_controller({"kind": kind, **more}, "test")
    return analyse_controllers(DeviceModel(model, 0.0, 0, 3.0), WIDE, [(kind, settings)], 0.5)[0]


def test_what_cannot_be_analysed_is_said() -> None:
    model = hystmpc.load_model("builtin:backlash", "conditioned")
    assert analysed("inverse", model).notes == ("no feedback",)
    late = analysed("pid", model, estimator={"sensor": "intermittent"})
    assert (late.margins, late.rest) == (None, "not analysed")
    assert "expected continuous" in late.notes[0]
    with pytest.raises(ControllerError, match="expected one within"):
        analyse_controllers(DeviceModel(model, 0.0, 0, 7.0), WIDE, [], 0.5)


def test_an_analysis_that_fails_is_a_note_and_costs_no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of a commissioning has it: five minutes of motion must not be lost for it."""
    model = hystmpc.load_model("builtin:backlash", "conditioned")

    def fails(*given: object) -> None:
        raise ValueError("List of state labels is the wrong length")

    monkeypatch.setattr("hystmpc.ctrl.linear.analysis.pid_system", fails)
    kinds = {kind: parse_controller({"kind": kind}, "test") for kind in ("pid", "linearised_mpc")}
    pid, plan = loops_of(model, "backlash", kinds, WIDE).controllers
    assert pid.rest == "not analysed"
    assert pid.notes == ("not analysed: ValueError: List of state labels is the wrong length",)
    assert plan.margins is not None


def test_an_oscillation_beyond_the_tolerance_is_too_great_for_a_hold() -> None:
    model = hystmpc.load_model("builtin:backlash", "conditioned")
    calm, wild = (analysed("pid", model, gains={"kp_per_deg": 0.01, "ki_per_deg_s": ki}) for ki in (0.3, 30.0))
    assert not calm.too_great
    assert wild.too_great
    margins: LoopMargins | None = wild.margins
    assert margins is not None
    assert not margins.stable


@pytest.mark.slow
def test_a_network_is_linearised_by_exact_derivatives() -> None:
    """Its answer to a small step of the command, at the end of a rise, is that of the network."""
    device = DeviceModel(hystmpc.load_model("builtin:lstm", "conditioned"), 0.08, 0, 3.0)
    predictor, step = device.harmonics.predictor, 1e-3
    state = predictor.initial(device.model.metadata.trained_angle.lower, 0.0)
    for u in np.append(np.linspace(0.0, 3.0, 200), np.full(100, 3.0)):
        state = predictor.advance(state, float(u))[1]
    held, moved = predictor.rollout(state, np.array([np.full(30, 3.0), np.full(30, 3.0 + step)]))
    system = device.linear
    linear = control.forced_response(system, device.model.dt * np.arange(31), np.ones(31), np.zeros(system.nstates))
    np.testing.assert_allclose(np.ravel(linear.outputs)[1:], (moved - held) / step, rtol=0.05, atol=0.05)


@pytest.mark.parametrize("phase", [45.0, 60.0])
def test_gains_by_margin_have_it_around_a_linear_device(phase: float) -> None:
    device = DeviceModel(model_of(Lag(0.2), Line(10.0, 20.0)), 0.0, 2, 3.0)
    gains = gains_by_margin(device, WIDE, PidSettings(dead_zone_deg=0.1), phase)
    margins = margins_of(device.linear * pid_system(gains, DT))
    assert margins.phase_deg == pytest.approx(phase, abs=2.0)
    assert gains.kp_per_deg == pytest.approx(0.2 * gains.ki_per_deg_s, rel=1e-3)
    assert gains.dead_zone_deg == 0.1


@pytest.mark.parametrize("name", ["backlash", "pi", "tendon-catheter"])
def test_gains_by_margin_make_no_limit_cycle_and_follow_the_unit_of_the_command(name: str) -> None:
    device = DeviceModel(hystmpc.load_model(f"builtin:{name}", "conditioned"), 0.1, 1, 3.0)
    gains = gains_by_margin(device, WIDE, PidSettings())
    loop = PidLoop(device.harmonics, gains, WIDE, device.delay_samples)
    assert not loop.analyse().oscillates
    assert (loop.delay_margin() or 0) >= 2


def test_a_model_that_does_not_answer_has_no_gains() -> None:
    dead = DeviceModel(model_of(Backlash(10.0, 10.0, 4.4, 0.0)), 0.0, 0, 3.0)
    with pytest.raises(ControllerError, match=r"got no answer of the model to 1\.5 around 3"):
        gains_by_margin(dead, WIDE, PidSettings())


def test_a_page_marks_what_a_hold_does_not_bear(tmp_path: object) -> None:
    controllers = {
        "calm": parse_controller({"kind": "pid", "gains": {"kp_per_deg": 0.01, "ki_per_deg_s": 0.3}}, "test"),
        "wild": parse_controller({"kind": "pid", "gains": {"kp_per_deg": 0.01, "ki_per_deg_s": 30.0}}, "test"),
        "plan": parse_controller({"kind": "linearised_mpc"}, "test"),
        "blind": parse_controller({"kind": "inverse"}, "test"),
    }
    model = hystmpc.load_model("builtin:backlash", "conditioned")
    analysis = loops_of(model, "builtin:backlash", controllers, WIDE, 0.08)
    text = analysis.report().html()
    assert "Do not run wild with these settings" in text
    assert text.count("<svg") == 2
    assert [row[0] for row in analysis.rows()] == list(controllers)
    assert "wild: " in repr(analysis)
    assert len(analysis.plot().axes) == 4


def test_a_loop_of_python_control_is_our_closed_loop() -> None:
    """Device and PID as its systems, joined by `interconnect`: limits, dead zone and anti-windup act."""
    gains = PidSettings(kp_per_deg=0.03, ki_per_deg_s=0.6, kd_s_per_deg=0.002, dead_zone_deg=0.3)
    model, tight = model_of(Lag(0.1), Backlash(10.0, 10.0, 2.4, 2.0)), CommandLimits(0.5, 5.0, 4.0)
    controller = hystmpc.build_controller(PidControllerSettings(gains=gains), model, limits=tight)
    wanted = np.where(np.arange(300) < 150, 65.0, 31.0)
    plant = ModelPlant(controller_model(model).predictive[0], 52.0, 3.0)
    log = run_loop(controller, plant, lambda k: np.array([wanted[k]]), wanted.size, u_start=3.0)
    pid, device = controller.to_control(), model.to_control()
    loop = control.interconnect(
        [pid, device],
        connections=[["device.command_mm", "controller.command"], ["controller.angle_deg", "device.angle_deg"]],
        inplist=["controller.reference_deg"],
        outlist=["controller.command", "device.angle_deg"],
    )
    rest = model.resting_x(52.0, 3.0)
    start = np.concatenate([[3.0 - tight.lower, 0.0, rest[-1], 3.0], rest])
    response = control.input_output_response(loop, DT * np.arange(wanted.size), wanted, start)
    np.testing.assert_allclose(response.outputs[0], log.command, rtol=0.0, atol=1e-9)
    assert np.ptp(log.command) > 3.0


def test_a_law_with_a_plan_is_no_fixed_law() -> None:
    with pytest.raises(ControllerError, match="expected a pid, which is a fixed law"):
        hystmpc.build_controller("linearised_mpc", "builtin:pi").to_control()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["backlash", "tendon-catheter", "auto"])
@pytest.mark.parametrize("adaptation", [{}, {"adaptation": None}])
def test_a_predictive_loop_survives_at_least_the_predicted_delay(name: str, adaptation: dict[str, None]) -> None:
    """The estimator's greatest gain is the worst case; the controller is not given the further delay."""
    model, lag = hystmpc.load_model(f"builtin:{name}", "conditioned"), 0.08
    settings = parse_controller({"kind": "linearised_mpc", **adaptation}, "test")
    (one,) = loops_of(model, name, {"mpc": settings}, WIDE, lag).controllers
    assert one.delay_samples is not None
    assert one.delay_samples >= 1
    controller = hystmpc.build_controller(settings, model, actuator_lag_s=lag)
    predictor = controller_model(model, None, lag).predictive[0]
    middle = float(predictor.rollout(predictor.initial(0.0, 3.0), np.full((1, 300), 3.0))[0, -1])
    plant = ModelPlant(predictor, middle, 3.0, delay_samples=one.delay_samples)
    reference = [np.full(controller.horizon, middle + 8.0 * (k < 300 and (k // 40) % 2)) for k in range(900)]
    log = run_loop(controller, plant, lambda k: reference[min(k, 899)], 900, u_start=3.0)
    assert np.ptp(log.measured_deg[-300:]) < 0.2
