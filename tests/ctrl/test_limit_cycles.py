"""Predicted limit cycles and delay margins of PID loops against simulated ones."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings, PidSettings
from hystmpc.ctrl.linear.limit_cycles import LoopAnalysis, PidLoop, analyse_pid
from hystmpc.ctrl.loop import LoopLog, run_loop
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.linear.harmonic import HarmonicModel
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators import dynamics as operators
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, Identification, Simulator

from .plays import DT, Lag, ModelPlant

LIMITS = CommandLimits(0.0, 6.0, 100.0)
SLOPE, HALF_WIDTH = 10.0, 0.2


def compiled_of(*parts: Operator) -> Simulator:
    """Simulator of operators in series, the last one the core."""
    return Simulator(
        chain=Chain(parts[-1], parts[:-1]),
        dt_s=DT,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=100.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=20.0, upper=85.0),
        trained_rate_per_s=12.0,
        identification=Identification(method="chosen by hand"),
    )


@cache
def backlash(lag_s: float) -> tuple[Predictor, Inverse]:
    """A symmetrical backlash behind a lag, compiled."""
    simulator = compiled_of(Backlash(SLOPE, SLOPE, 2.2 + HALF_WIDTH, 2.2 - HALF_WIDTH))
    known = controller_model(ChainModel(simulator))
    return known.behind((operators.Lag(lag_s),), simulator.metadata()).predictive if lag_s else known.predictive


def simulated(kind: str, lag_s: float, kp: float, ki: float, dead_zone: float) -> LoopLog:
    predictor, inverse = backlash(lag_s)
    settings = {"pid": PidControllerSettings, "inverse_pid": InversePidControllerSettings}[kind].parse(
        {"gains": {"kp_per_deg": kp, "ki_per_deg_s": ki, "dead_zone_deg": dead_zone}}
    )
    controller = build_controller(settings, predictor, inverse, LIMITS)
    plant = ModelPlant(predictor, 50.0, 3.0, offset_deg=3.0)  # an exact feedforward would leave the loop nothing to do
    return run_loop(controller, plant, lambda _: np.full(controller.horizon, 55.0), 2000, u_start=3.0)


@cache
def predicted(lag_s: float, kp: float, ki: float, dead_zone: float) -> LoopAnalysis:
    return analyse_pid(backlash(lag_s)[0], PidSettings(kp_per_deg=kp, ki_per_deg_s=ki, dead_zone_deg=dead_zone), LIMITS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
@pytest.mark.parametrize(
    ("lag_s", "kp", "ki", "dead_zone"), [(0.1, 0.02, 2.5, 0.0), (0.2, 0.02, 1.5, 0.0), (0.1, 0.02, 2.5, 0.5)]
)
def test_limit_cycle_is_the_simulated_one(kind: str, lag_s: float, kp: float, ki: float, dead_zone: float) -> None:
    cycle = predicted(lag_s, kp, ki, dead_zone).cycle
    log = simulated(kind, lag_s, kp, ki, dead_zone)
    angle, command = log.measured_deg[-750:], log.command[-750:]
    rising = np.flatnonzero(np.diff(np.sign(angle - angle.mean())) > 0)
    assert cycle is not None
    assert np.diff(rising).mean() * DT == pytest.approx(1.0 / cycle.frequency_hz, rel=0.2)
    assert 0.5 * np.ptp(angle) == pytest.approx(cycle.angle_deg, rel=0.2)
    assert 0.5 * np.ptp(command) == pytest.approx(cycle.command, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
@pytest.mark.parametrize(("lag_s", "kp", "ki", "dead_zone"), [(0.1, 0.02, 0.3, 0.2), (0.05, 0.05, 0.5, 0.2)])
def test_where_none_is_predicted_the_loop_comes_to_rest(
    kind: str, lag_s: float, kp: float, ki: float, dead_zone: float
) -> None:
    found = predicted(lag_s, kp, ki, dead_zone)
    assert (found.cycle, found.diverges, str(found)) == (None, False, "no limit cycle")
    assert found.gain < 0.5
    assert np.ptp(simulated(kind, lag_s, kp, ki, dead_zone).measured_deg[-750:]) < 0.05


@pytest.mark.slow
def test_delay_makes_the_loop_hunt() -> None:
    gains = PidSettings(kp_per_deg=0.02, ki_per_deg_s=0.8, dead_zone_deg=0.0)
    model = backlash(0.1)[0]
    found = [analyse_pid(model, gains, LIMITS, delay) for delay in (0, 4, 8)]
    assert found[0].cycle is None
    assert found[0].gain < found[1].gain < found[2].gain
    assert (found[2].diverges, str(found[2])) == (True, "grows to the command limits")


def test_a_loop_that_is_unstable_without_backlash_grows_to_the_limits() -> None:
    found = analyse_pid(Lag(g=10.0), PidSettings(kp_per_deg=0.0, ki_per_deg_s=20.0, dead_zone_deg=0.0), LIMITS)
    assert (found.cycle, found.diverges) == (None, True)


def loop(*operators: Operator, kp: float, ki: float, dead_zone: float = 0.0, delay: int = 0) -> PidLoop:
    """Loop of a PID around operators in series, the last one the core, at 3 mm."""
    simulator = compiled_of(*operators)
    gains = PidSettings(kp_per_deg=kp, ki_per_deg_s=ki, dead_zone_deg=dead_zone)
    predictor = controller_model(ChainModel(simulator)).predictive[0]
    return PidLoop(HarmonicModel(predictor, simulator.chain.operators, 3.0), gains, LIMITS, delay)


def test_without_hysteresis_it_is_the_linear_stability_of_the_library() -> None:
    """The loop is stable as long as all poles of python-control's closed loop lie within the unit circle."""
    import control

    lag, gain = 0.1, 10.0
    left, kp, ki = np.exp(-DT / lag), 0.02, 0.8
    plant = control.tf([gain * (1.0 - left)], [1.0, -left], DT)
    pid = control.tf([kp, ki * DT - kp], [1.0, -1.0], DT)
    margins = []
    for delay in range(12):
        poles = control.feedback(plant * pid * control.tf([1.0], [1.0] + [0.0] * delay, DT), 1).poles()
        stable = bool(np.all(np.abs(poles) < 1.0))
        found = loop(operators.Lag(lag), Line(gain, 0.0), kp=kp, ki=ki, delay=delay).analyse()
        assert found.oscillates is not stable
        margins += [delay] if stable else []
    assert loop(operators.Lag(lag), Line(gain, 0.0), kp=kp, ki=ki).delay_margin() == margins[-1]


@pytest.mark.parametrize("ki", [0.3, 1.5, 2.5])
def test_closed_form_and_settled_cycles_predict_the_same(ki: float) -> None:
    exact = loop(operators.Lag(0.2), Backlash(SLOPE, SLOPE, 2.4, 2.0), kp=0.02, ki=ki)
    driven = replace(exact, model=replace(exact.model, operators=()))
    one, two = exact.analyse(), driven.analyse()
    assert (one.cycle is None, one.diverges) == (two.cycle is None, two.diverges)
    assert one.gain == pytest.approx(two.gain, rel=0.2)
    if one.cycle and two.cycle:
        assert two.cycle.angle_deg == pytest.approx(one.cycle.angle_deg, rel=0.1)
        assert two.cycle.frequency_hz == pytest.approx(one.cycle.frequency_hz, rel=0.05)


def test_an_unstable_limit_cycle_lies_below_a_stable_one() -> None:
    """From below it the oscillation decays: the balance is crossed the other way."""
    found = loop(operators.Lag(0.2), Backlash(SLOPE, SLOPE, 2.4, 2.0), kp=0.02, ki=1.5).analyse()
    assert [cycle.stable for cycle in found.cycles] == [False, True]
    assert found.cycle is not None
    assert 0.0 < found.starts_at < found.cycle.command


def test_what_the_method_leaves_out_is_a_doubt() -> None:
    found = loop(operators.Lag(0.1), Backlash(SLOPE, SLOPE, 2.4, 2.0), kp=0.02, ki=2.5)
    slow = replace(found, limits=replace(LIMITS, rate=5.0)).analyse().cycle
    assert slow is not None
    assert "the rate limit acts" in slow.doubts
    assert "doubtful: " in str(replace(found, limits=replace(LIMITS, rate=5.0)).analyse())
