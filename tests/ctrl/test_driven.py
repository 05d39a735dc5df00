"""What controllers promise on an exactly known model with lag, delay or servo before its hysteresis."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.feedback import REFERENCE_DEAD_ZONE_DEG
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.loop import LoopLog, run_loop
from hystmpc.models.chain import Chain
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators import dynamics
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator

from .plays import DT, PI, ModelPlant, compiled

LIMITS = CommandLimits(0.0, 6.0, 12.0)
CORES: dict[str, Operator] = {"backlash": Backlash(10.27, 10.70, 2.822, 2.003), "pi": PI}
DRIVES: dict[str, tuple[Operator, ...]] = {
    "none": (),
    "lag 0.05": (dynamics.Lag(0.05),),
    "lag 0.12": (dynamics.Lag(0.12),),
    "lag 0.25": (dynamics.Lag(0.25),),
    "delay 1": (dynamics.Delay(DT, 1),),
    "delay 4": (dynamics.Delay(4 * DT, 4),),
    "delay and lag": (dynamics.Delay(2 * DT, 2), dynamics.Lag(0.12)),
    "servo": (dynamics.Servo(0.1, 0.6),),
    "two ways": (dynamics.Lag(0.08, (0.2,)),),
}
REST = {"backlash": 10.27 * 2.822, "pi": 22.0}
SECONDS, START = 12.0, 1.0


@cache
def model(core: str, drive: str) -> tuple[Predictor, Inverse]:
    return compiled(Chain(CORES[core], DRIVES[drive]))


@cache
def feasible(core: str) -> np.ndarray:
    """Angles that every drive can follow: those of the slowest one under a smooth command that keeps the limits."""
    predictor, t = model(core, "lag 0.25")[0], DT * np.arange(round(SECONDS / DT) + 60)
    commands = 2.4 - 2.2 * np.cos(2 * np.pi * 0.25 * t) * np.minimum(t, 1.0) - 2.4 * (1 - np.minimum(t, 1.0))
    commands[t > 8.0] = commands[round(8.0 / DT)]
    state = predictor.initial(REST[core], 0.0)
    return predictor.rollout(state, commands[None])[0]


def tracked(kind: str, core: str, drive: str, **options: Any) -> tuple[LoopLog, np.ndarray]:
    """Log and errors of the true angle [deg] along the feasible angles."""
    predictor, inverse = model(core, drive)
    controller = build_controller(CONTROLLERS[kind].parse({"kind": kind, **options}), predictor, inverse, LIMITS)
    wanted, plant = feasible(core), ModelPlant(predictor, REST[core], 0.0)
    steps = round(SECONDS / DT)
    log = run_loop(controller, plant, lambda k: wanted[k : k + controller.horizon], steps, u_start=0.0)
    return log, np.array(plant.true[1:]) - log.reference_deg


def rmse(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error[round(START / DT) :] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "drive"),
    [*(("backlash", name) for name in DRIVES if name != "none"), ("pi", "lag 0.12"), ("pi", "delay and lag")],
)
def test_the_inverse_follows_as_without_the_drive(core: str, drive: str) -> None:
    """Within 1.2 times the error without it, and what the reference's dead zone leaves."""
    log, error = tracked("inverse", core, drive)
    assert rmse(error) <= max(1.2 * rmse(tracked("inverse", core, "none")[1]), REFERENCE_DEAD_ZONE_DEG)
    moves = np.abs(np.diff(log.command, prepend=0.0))
    assert np.max(moves) <= LIMITS.rate * DT * (1 + 1e-9)
    assert np.ptp(log.command[-50:]) < 1e-9  # the reference has come to rest


@pytest.mark.parametrize(("sensor", "more_deg"), [("continuous", 0.005), ("none", 0.001)])
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("core", CORES)
def test_a_plan_follows_as_closely_as_the_inverse(core: str, drive: str, sensor: str, more_deg: float) -> None:
    """To the tolerance of a hold, also where a dead band has to be crossed out of one."""
    _, error = tracked("linearised_mpc", core, drive, estimator={"sensor": sensor})
    assert rmse(error) <= rmse(tracked("inverse", core, drive)[1]) + more_deg


@pytest.mark.parametrize("sensor", ["continuous", "none"])
@pytest.mark.parametrize("kind", ["linearised_mpc", "sampling_mpc"])
@pytest.mark.parametrize("drive", ["none", "delay 4"])
def test_a_dead_band_is_crossed_in_time_and_no_earlier(drive: str, kind: str, sensor: str) -> None:
    """At the end of a long hold the command moves as many samples before the reference as the rate limit asks for."""
    predictor, inverse = model("backlash", drive)
    settings_ = CONTROLLERS[kind].parse({"kind": kind, "estimator": {"sensor": sensor}})
    controller = build_controller(settings_, predictor, inverse, LIMITS)
    ends = np.array([0, 50, 100, 150]), np.array([0.0, 4.5, 4.5, 0.5])  # up, a hold of two seconds, down
    wanted = predictor.rollout(predictor.initial(REST["backlash"], 0.0), np.interp(np.arange(180), *ends)[None])[0]
    plant = ModelPlant(predictor, REST["backlash"], 0.0)
    log = run_loop(controller, plant, lambda k: wanted[k : k + controller.horizon], 150, u_start=0.0)
    leaves = int(np.flatnonzero(np.abs(np.diff(wanted[100:])) > 0.01)[0]) + 101  # the first angle off the hold
    arrives = leaves - (4 if drive == "delay 4" else 0)
    needed = int(np.ceil((log.command[99] - log.command[arrives]) / (LIMITS.rate * DT)))
    moved = int(np.flatnonzero(np.abs(np.diff(log.command[70:])) > 1e-6)[0]) + 71
    assert needed >= 2
    assert arrives - needed <= moved <= arrives
    assert np.abs(np.array(plant.true[1:]) - log.reference_deg)[60:].max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "drive"),
    [
        ("backlash", "lag 0.12"),
        ("backlash", "delay 4"),
        ("backlash", "servo"),
        ("backlash", "delay and lag"),
        ("pi", "delay and lag"),
    ],
)
def test_sampling_is_level_with_the_linearised_controller(core: str, drive: str) -> None:
    """Within a tenth, and a hundredth of a degree."""
    linearised, sampling = (rmse(tracked(kind, core, drive)[1]) for kind in ("linearised_mpc", "sampling_mpc"))
    assert sampling <= 1.1 * linearised + 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linearised_mpc", "sampling_mpc"])
def test_a_delay_of_the_model_does_not_make_a_hold_end_late(kind: str) -> None:
    """A command that shows four samples later leaves its hold four samples before the reference does."""
    error = {drive: tracked(kind, "pi", drive)[1] for drive in ("none", "delay 4")}
    assert rmse(error["delay 4"]) <= 1.2 * rmse(error["none"]) + 0.01


@cache
def controller_for(kind: str, drive: str) -> GuardedController:
    options: dict[str, Any] = {"samples": 16} if kind == "sampling_mpc" else {}
    return build_controller(CONTROLLERS[kind].parse({"kind": kind, **options}), *model("backlash", drive), LIMITS)


@pytest.mark.parametrize("drive", ["delay and lag", "servo"])
@pytest.mark.parametrize("kind", ["inverse", "inverse_pid", "linearised_mpc", "sampling_mpc"])
@given(levels=st.lists(st.floats(0.0, 120.0), min_size=1, max_size=6), noise=st.integers(0, 100))
@settings(max_examples=8, deadline=None)
def test_limits_hold_along_any_reference(kind: str, drive: str, levels: list[float], noise: int) -> None:
    controller, random = controller_for(kind, drive), np.random.default_rng(noise)
    plant = ModelPlant(model("backlash", drive)[0], REST["backlash"], 0.0, noise_deg=0.15, seed=noise)
    wanted = np.repeat(levels, 5) + random.normal(0.0, 5.0, 5 * len(levels))
    wanted = np.append(wanted, np.full(40, wanted[-1]))
    log = run_loop(controller, plant, lambda k: wanted[k : k + 40], 5 * len(levels), u_start=0.0)
    assert np.all((log.command >= LIMITS.lower) & (log.command <= LIMITS.upper))
    assert np.max(np.abs(np.diff(log.command, prepend=0.0))) <= LIMITS.rate * DT * (1 + 1e-9)
    assert set(log.source) <= {"mpc", "controller"}
