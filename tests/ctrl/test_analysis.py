"""Describing functions against the library's, and predicted limit cycles against simulated ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hystmpc.ctrl.analysis import LoopAnalysis, analyse_pid, describing_function
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings, PidSettings
from hystmpc.ctrl.loop import LoopLog, run_loop
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators import dynamics as operators
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, Identification, Simulator
from hystmpc.trials.errors import ControllerError

from .plays import DT, Lag, ModelPlant

LIMITS = CommandLimits(0.0, 6.0, 100.0)
SLOPE, HALF_WIDTH = 10.0, 0.2


@cache
def backlash(lag_s: float) -> tuple[Predictor, Inverse]:
    """A symmetrical backlash behind a lag, compiled."""
    operator = Backlash(SLOPE, SLOPE, 2.2 + HALF_WIDTH, 2.2 - HALF_WIDTH)
    simulator = Simulator(
        chain=Chain(operator),
        dt_s=DT,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=100.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=20.0, upper=85.0),
        trained_rate_per_s=12.0,
        identification=Identification(method="chosen by hand"),
    )
    known = controller_model(ChainModel(simulator))
    return known.behind((operators.Lag(lag_s),), simulator.metadata()).predictive if lag_s else known.predictive


def test_describing_function_is_that_of_control() -> None:
    from control import friction_backlash_nonlinearity

    amplitudes = np.array([0.1, 0.25, 0.5, 1.0, 2.5])
    library = friction_backlash_nonlinearity(2.0 * HALF_WIDTH)
    ours = describing_function(backlash(0.0)[0], 3.0, amplitudes, 400)
    wanted = [SLOPE * library.describing_function(a) for a in amplitudes]
    np.testing.assert_allclose(ours, wanted, atol=2e-3)


def test_describing_function_of_a_linear_model_is_its_frequency_response() -> None:
    model, samples = Lag(a=0.6, g=10.0), 50
    z = np.exp(2j * np.pi / samples)
    expected = (1 - model.a) * model.g / (1 - model.a / z)
    np.testing.assert_allclose(describing_function(model, 1.0, np.array([0.1, 2.0]), samples), expected, rtol=1e-6)


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


def test_impossible_questions_are_refused() -> None:
    with pytest.raises(ControllerError, match="describing function: got"):
        describing_function(Lag(), 1.0, np.array([0.0]), 10)
