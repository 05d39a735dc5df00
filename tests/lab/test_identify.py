"""The identification study: its devices, its motions, the compiled search, and the bars."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.feedback import PidControllerSettings, PidSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.sim.study import run_closed_loop
from hystmpc.trials.errors import FitError
from hystmpc_lab.devices import kernels
from hystmpc_lab.devices.drawn import FAMILIES, OUTSIDE, DrawnDevice, DrawnPlant, draw_devices
from hystmpc_lab.devices.exact import ExactInverse, ExactPredictor, exact_controller
from hystmpc_lab.devices.kernels import PidNumbers
from hystmpc_lab.devices.motions import fresh_motions, recordings
from hystmpc_lab.identify.settings import (
    CONTROLLERS,
    IdentifyJob,
    IdentifyOutcome,
    IdentifyResult,
    IdentifySettings,
    bars,
)

DEVICES = draw_devices(12, seed=3)
DRAWN = (*draw_devices(4, seed=3, quick=True), *draw_devices(2, 3, True, OUTSIDE))
QUIET = [replace(device, noise_deg=0.0) for device in DRAWN]
of_family = pytest.mark.parametrize("device", QUIET, ids=[*FAMILIES, *OUTSIDE])


def sample_by_sample(device: DrawnDevice, commands: np.ndarray) -> np.ndarray:
    plant = DrawnPlant(device, 0)
    plant.reset()
    return np.array([plant.apply(float(u)) for u in commands])


def test_equal_seeds_draw_equal_devices_and_a_quarter_lacks_each_part() -> None:
    drawn = draw_devices(60, seed=7)
    assert drawn == draw_devices(60, seed=7)
    assert drawn != draw_devices(60, seed=8)
    for part in ("lag", "delay", "creep"):
        assert sum(device.truth[part] == 0 for device in drawn) >= 15
    assert {(d.family, d.rate_hz) for d in drawn} == {(f, r) for f in FAMILIES for r in (25.0, 50.0, 250.0)}
    assert all(0 <= d.delay_s * d.rate_hz <= 4.5 and 0.03 <= d.noise_deg <= 0.3 for d in drawn)


@of_family
def test_a_device_at_rest_stays_where_it_is(device: DrawnDevice) -> None:
    plant = DrawnPlant(device, 0)
    first = plant.reset()
    assert sample_by_sample(device, np.zeros(50))[-1] == pytest.approx(first, abs=0.05)


@of_family
def test_the_angle_never_falls_while_the_command_rises_nor_the_other_way_round(device: DrawnDevice) -> None:
    bare = replace(device, lag_s=0.0, damping=0.0, delay_s=0.0, creep=0.0)
    up = np.linspace(0.0, bare.limits.upper, 200)
    theta = sample_by_sample(bare, np.concatenate([up, up[::-1]]))
    assert np.all(np.diff(theta[:200]) >= -1e-6)
    assert np.all(np.diff(theta[200:]) <= 1e-6)
    assert theta[300] > theta[99] + 0.2, "no hysteresis"


def test_a_delay_shifts_the_answer_by_its_whole_samples() -> None:
    device = replace(QUIET[1], delay_s=0.0)
    late = replace(device, delay_s=3 / device.rate_hz)
    u = 3.0 + np.sin(np.linspace(0, 20, 200))
    assert sample_by_sample(late, u)[3:] == pytest.approx(sample_by_sample(device, u)[:-3], abs=1e-3)


def test_a_servo_stays_behind_a_ramp_by_its_lag() -> None:
    bare = replace(QUIET[2], delay_s=0.0, creep=0.0, lag_s=0.2)
    places = []
    for damping in (0.0, 0.7):
        plant = DrawnPlant(replace(bare, damping=damping), 0)
        state, q = plant.rest[1].copy(), plant.packed.commands
        for u in np.arange(1, 101) * 0.02:
            kernels.advance(plant.packed, state, float(u))
        places.append(2.0 - 0.5 * state[q])  # the command is a staircase of 0.5 mm/s
    assert places[0] == pytest.approx(places[1], abs=0.02)


@of_family
def test_a_compiled_search_sees_what_the_controller_does(device: DrawnDevice) -> None:
    noisy = DrawnPlant(replace(device, noise_deg=0.1), 5)
    motion = fresh_motions(noisy, quick=True)[0]
    gains = PidSettings(kp_per_deg=0.01, ki_per_deg_s=0.15, kd_s_per_deg=0.001, dead_zone_deg=0.1)
    limits, predictor = device.limits, ExactPredictor(device)
    controller = build_controller(PidControllerSettings(gains=gains), predictor, ExactInverse(predictor), limits)
    first = motion.first(noisy.dt)
    run = run_closed_loop(controller, noisy, motion.trajectory)
    numbers = PidNumbers(0.01, 0.15, 0.001, 0.1, 0.1, 0.1, limits.lower, limits.upper, limits.rate * noisy.dt, noisy.dt)
    wanted, (angle, rest) = motion.wanted(noisy.dt), noisy.rest
    silent, noise = np.zeros(wanted.size), noisy.noise(wanted.size)
    found = kernels.pid_square_error(noisy.packed, rest, wanted, wanted, silent, noise, first, numbers, angle)
    assert found == pytest.approx(float(np.mean(run.error_deg[first:] ** 2)), rel=1e-9)


@of_family
def test_who_knows_the_device_predicts_it(device: DrawnDevice) -> None:
    predictor = ExactPredictor(device)
    u = 0.5 * device.limits.upper * (1 - np.cos(np.linspace(0, 9, 60)))
    state = predictor.initial(0.0, 0.0)
    behind = predictor.delay_samples
    ahead = predictor.rollout(state, u[None])[0]
    assert ahead[: 60 - behind] == pytest.approx(sample_by_sample(device, u)[behind:], abs=1e-6)
    theta, jacobian = predictor.linearise(state, u)
    assert theta == pytest.approx(ahead)
    assert np.all(np.triu(jacobian, 3) == 0)  # 60 samples move in 24 blocks of two or three
    moved = u + 1e-3 * device.limits.upper
    change = predictor.rollout(state, moved[None])[0] - ahead
    assert jacobian.sum(axis=1) * 1e-3 * device.limits.upper == pytest.approx(change, abs=0.1)


@pytest.mark.slow
def test_who_knows_the_device_follows_it_closely() -> None:
    plant = DrawnPlant(replace(QUIET[1], noise_deg=0.1), 1)
    motion, controller = (
        fresh_motions(plant, quick=True)[0],
        exact_controller(plant.device, LinearisedMpcSettings()),
    )
    run = run_closed_loop(controller, plant, motion.trajectory)
    assert math.sqrt(np.mean(run.error_deg[motion.first(plant.dt) :] ** 2)) < 0.1


@of_family
def test_recordings_keep_to_the_limits_and_begin_and_end_at_rest(device: DrawnDevice) -> None:
    trials = recordings(DrawnPlant(device, 1))
    assert 165 < sum(trial.t.size * trial.dt for trial in trials) < 195
    for trial in trials:
        assert trial.command[0] <= device.limits.rate * trial.dt
        assert trial.command[-1] == 0
        assert np.all((trial.command >= 0) & (trial.command <= device.limits.upper))
        assert np.max(np.abs(np.diff(trial.command))) <= device.limits.rate * trial.dt * (1 + 1e-9)


@pytest.mark.parametrize("device", DEVICES, ids=[device.key for device in DEVICES])
def test_fresh_motions_lie_within_what_the_device_reaches(device: DrawnDevice) -> None:
    plant = DrawnPlant(device, 1)
    low, high = plant.reachable_deg
    for motion in fresh_motions(plant):
        counted = motion.wanted(plant.dt)[motion.first(plant.dt) :]
        assert np.all((counted >= low) & (counted <= high)), motion.name
        assert np.ptp(counted) > 0.1 * (high - low)


def result(number: int, **changes: object) -> IdentifyResult:
    """A device that is done: MPC at half of its rivals, everything found right."""
    figures = {f"{name}.rmse_deg": 0.2 for name in CONTROLLERS} | {"pid.rmse_deg": 0.4, "inverse_pid.rmse_deg": 0.5}
    figures |= {f"{name}.violations": 0.0 for name in CONTROLLERS}
    figures |= {"as_identified_linearised.rmse_deg": 0.1, "as_identified_inverse.rmse_deg": 0.1}
    figures |= {"linearised.hold_samples": 100.0, "linearised.rest_samples": 100.0}
    made = IdentifyResult(
        IdentifyJob(number, f"{number:03d}"),
        "",
        "done",
        "",
        1.0,
        truth={"lag": 0.1, "delay": 0.0, "creep": 0.05},
        found={"lag": (0.1, 0.09, 0.11), "creep": (0.03, 0.02, 0.04)},
        facts={"family": "dahl", "rate_hz": 25.0, "servo_damping": 0.0, "noise_deg": 0.1},
        figures=figures,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def states(*results: IdentifyResult) -> dict[str, tuple[float, str, int]]:
    settings = IdentifySettings(kind="pi")
    return {b.name: (b.value, b.state, b.cases) for b in bars(IdentifyOutcome(settings, results, Path()))}


def test_bars_count_what_they_say() -> None:
    found = states(result(0), result(1, found={"delay": (0.1, 0.05, 0.2)}))
    assert found["ratio to the best tuned rival: median"] == (0.5, "met", 2)
    assert found["lag within its 90 % interval"] == (0.5, "missed", 2)
    assert found["creep within its 90 % interval"] == (0.0, "missed", 2)
    assert found["delay within its 90 % interval"][1:] == ("not measured", 0)
    assert found["delay invented"] == (0.5, "missed", 2)
    unsure = states(result(0), result(1, found={"delay": (0.1, -0.05, 0.2)}))
    assert unsure["delay invented"] == (0.0, "met", 2)  # the report says that it may be none
    assert found["lag invented"][2] == 0
    assert found["settled hold time at rest"][:2] == (1.0, "met")
    assert found["samples beyond a limit, all controllers"][:2] == (0.0, "met")


def test_the_lag_of_a_servo_is_not_judged_and_a_failed_device_is_the_worst() -> None:
    servo = result(0, facts=dict(result(0).facts) | {"servo_damping": 0.8})
    failed = replace(result(1), status="failed", figures={}, found={})
    found = states(servo, failed)
    assert found["lag within its 90 % interval"][2] == 0
    value, state, _ = found["ratio to the best tuned rival: worst"]
    assert math.isinf(value)
    assert state == "missed"


def test_an_unknown_kind_is_refused_before_anything_is_drawn() -> None:
    with pytest.raises(FitError, match="no kind of model 'nothing'"):
        IdentifySettings.of(kind="nothing")
